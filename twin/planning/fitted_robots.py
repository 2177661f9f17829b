"""Robot models with the changes that a scenario specifies: tools, flanges, limits and fixed joints."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from planning.cell.robot_model import RobotModel
from planning.cell.shape import Element
from planning.errors import FittingError, RobotModelError, ShapeError
from planning.files import resolve_file_name
from planning.robots.descriptions.fitting import Fitting, Tool
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
        return robot_model(robot.model, folder, replace(fitting, bare=True))
    own = tools.get(robot.tool or "")
    if own is None and robot.tool is not None:
        robot_model(robot.model, folder)  # a missing model is reported first
    model = robot.model if own else with_tool(robot.model, robot.tool, tuple(tools))
    tool = build_tool(str(robot.tool), own, folder) if own else None
    return robot_model(model, folder, replace(fitting, tool=tool))


def robot_fitting(robot: RobotSection, cell: CellSection, folder: Path) -> Fitting:
    """Return the changes to the description of a robot, but for its tools.

    Raises:
        FittingError: it contradicts another robot of the same description.
    """
    limits = build_limits(robot.limits)
    fitting = Fitting(flange=robot.flange, held=robot.joints, limits=limits)
    if "other arms" not in HOOKS:
        return fitting
    found: Fitting = HOOKS.load("other arms")(fitting, robot, cell, folder)
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
