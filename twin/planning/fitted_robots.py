"""Robot models with the changes that a scenario specifies: tools, flanges, limits and fixed joints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from planning.cell.robot_model import RobotModel
from planning.cell.shape import Element
from planning.errors import FittingError, RobotModelError, ShapeError
from planning.files import resolve_file_name
from planning.robots.descriptions.fitting import BY_HAND, Fitting, Tool
from planning.robots.descriptions.urdf_file import BY_JOINT, GivenLimits
from planning.robots.registry import robot_model, with_tool
from twin.planning.shapes import build_shape
from twin.registry import HOOKS
from twin.scenario.sections.cell import (
    CellSection,
    LimitsSection,
    RobotSection,
    ToolSection,
)
from twin.scenario.sections.shapes import ShapeSection, to_planning_class

_DESCRIBED, DESCRIPTION_FILE = "described robot", "description file"
"""Hooks that read what a vendor gives beside a description, and descriptions in other formats."""

_OF_VENDOR = ("srdf", "home", "xacro")
"""Keys of a robot for that hook."""


def fitted_model(robot: RobotSection, cell: CellSection, folder: Path) -> RobotModel:
    """Return a robot model with the scenario's additions; without a tool if the robot changes tools.

    Args:
        robot: of the cell.
        cell: the cell.
        folder: where relative paths start.

    Raises:
        FittingError: an addition does not fit; the message names the key.
        RobotModelError: the description of the robot cannot be used.
    """
    tools, fitting = cell.tools, robot_fitting(robot, cell, folder)
    if robot.tools:
        left = dict.fromkeys(robot.with_only(None).ignore_contacts, BY_HAND)
        bare = replace(fitting, bare=True, ignored=left)
        return model_with(robot, robot.model, folder, bare)
    own = tools.get(robot.tool or "")
    if own is None and robot.tool is not None:
        model_with(robot, robot.model, folder, Fitting())  # a missing one comes first
    model = robot.model if own else with_tool(robot.model, robot.tool, tuple(tools))
    tool = build_tool(str(robot.tool), own, folder) if own else None
    return model_with(robot, model, folder, replace(fitting, tool=tool))


def robot_fitting(robot: RobotSection, cell: CellSection, folder: Path) -> Fitting:
    """Return the changes to the description of a robot, but for its tools.

    Raises:
        FittingError: it contradicts another robot of the same description.
    """
    limits = build_limits(robot.limits)
    ignored = dict.fromkeys(robot.ignore_contacts, BY_HAND)
    fitting = Fitting(
        flange=robot.flange, held=robot.joints, limits=limits, ignored=ignored
    )
    if "other arms" not in HOOKS:
        return fitting
    found: Fitting = HOOKS.load("other arms")(fitting, robot, cell, folder)
    return found


def model_with(
    robot: RobotSection, model: str, folder: Path, fitting: Fitting
) -> RobotModel:
    """Return a robot model with some changes to its description, and with what its vendor says of it.

    Raises:
        RobotModelError: a file cannot be used.
    """
    given = {key: value for key in _OF_VENDOR if (value := getattr(robot, key))}
    if robot.srdf is False:
        given["srdf"] = False
    return described_model(model, folder, fitting, given)


def described_model(
    model: str, folder: Path, fitting: Fitting, given: Mapping[str, Any]
) -> RobotModel:
    """Return a robot model with what its vendor says in further files.

    Args:
        model: name of a registered robot or path of a description.
        folder: where relative paths start.
        fitting: changes of the cell.
        given: the keys ``srdf``, ``home`` and ``xacro`` of the robot, as far as given.

    Raises:
        RobotModelError: a file cannot be used.
    """
    if not given and _DESCRIBED not in HOOKS:
        return robot_model(model, folder, fitting)
    read = HOOKS.require(_DESCRIBED, "a model with " + ", ".join(given))
    found: RobotModel = read(model, folder, fitting, **given)
    return found


def build_tool(name: str, section: ToolSection, folder: Path) -> Tool:
    """Return the planning model of a tool.

    Raises:
        FittingError: its description is not there, or one of its shapes cannot be used.
    """
    description, shapes = None, tuple[Element, ...]()
    try:
        if section.description is not None:
            file = resolve_file_name(section.description, folder, RobotModelError)
            description = file.resolve()
            if DESCRIPTION_FILE in HOOKS:
                description = HOOKS.load(DESCRIPTION_FILE)(description)
        if section.shapes:
            whole = ShapeSection(compound=section.shapes)
            shapes = build_shape(name, whole, folder).elements
    except (RobotModelError, ShapeError) as error:
        raise FittingError(f"the tool {name!r}: {error}", key="tool") from None
    return to_planning_class(
        Tool,
        section,
        name=name,
        description=description,
        shapes=shapes,
        held=section.joints,
        grip=section.grip(name),
    )


def build_limits(section: LimitsSection) -> GivenLimits:
    """Return the planning model of a robot's limits."""
    own = {key: getattr(section, key) for key in BY_JOINT}
    listed = {k: (v,) if isinstance(v, float) else v for k, v in own.items()}
    return GivenLimits(payload=section.payload_kg, **listed)
