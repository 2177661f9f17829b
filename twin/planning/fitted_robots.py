"""Robot models as a scenario fits them out: with tools, flanges, limits and joints that are held."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from planning.cell.robot_model import RobotModel
from planning.cell.shape import Element
from planning.errors import FittingError, RobotModelError, ShapeError
from planning.files import file_named
from planning.robots.descriptions.fitting import Fitting, GivenLimits, Tool
from planning.robots.registry import robot_model, with_tool
from twin.planning.build_workcell import build_shape
from twin.scenario.sections.cell import LimitsSection, RobotSection, ToolSection
from twin.scenario.sections.shapes import ShapeSection, plain_values


def fitted_model(
    robot: RobotSection, tools: Mapping[str, ToolSection], folder: Path
) -> RobotModel:
    """Return the type of a robot with what the cell adds to it; of one that changes tools, bare.

    Args:
        robot: of the cell.
        tools: of the cell, by name.
        folder: where relative paths start.

    Raises:
        FittingError: what is added does not fit; it says which key is at fault.
        RobotModelError: the description of the robot cannot be used.
    """
    if robot.tools:
        return robot_model(robot.model, folder, _fitting(robot, bare=True))
    own = tools.get(robot.tool or "")
    if own is None and robot.tool is not None:
        robot_model(robot.model, folder)  # a model that there is not is said first
    model = robot.model if own else with_tool(robot.model, robot.tool, tuple(tools))
    tool = build_tool(str(robot.tool), own, folder) if own else None
    return robot_model(model, folder, _fitting(robot, tool))


def _fitting(
    robot: RobotSection, tool: Tool | None = None, *, bare: bool = False
) -> Fitting:
    return Fitting(
        tool=tool,
        bare=bare,
        flange=robot.flange,
        held=robot.joints,
        limits=build_limits(robot.limits),
    )


def build_tool(name: str, section: ToolSection, folder: Path) -> Tool:
    """Return a tool of a cell as planning knows it."""
    said = ("description", "shapes", "joints", "opening_m", "suction", "rack")
    return Tool(
        name=name,
        description=_description(name, section, folder),
        shapes=_shapes(name, section, folder),
        held=section.joints,
        grip=section.grip(name),
        **plain_values(section, without=said),
    )


def _description(name: str, section: ToolSection, folder: Path) -> Path | None:
    if section.description is None:
        return None
    try:
        return file_named(section.description, folder, RobotModelError).resolve()
    except RobotModelError as error:
        raise FittingError(f"the tool {name!r}: {error}", key="tool") from None


def _shapes(name: str, section: ToolSection, folder: Path) -> tuple[Element, ...]:
    """Return the forms of a tool that is made of shapes."""
    if not section.shapes:
        return ()
    whole = ShapeSection(compound=section.shapes)
    try:
        return build_shape(name, whole, folder).elements
    except ShapeError as error:
        raise FittingError(f"the tool {name!r}: {error}", key="tool") from None


def build_limits(section: LimitsSection) -> GivenLimits:
    """Return the limits of a robot as planning knows them."""
    speeds = ("tool_speed_m_s", "loaded_tool_speed_m_s", "payload_kg")
    given = plain_values(section, without=speeds)
    listed = {k: v if isinstance(v, tuple) else (v,) for k, v in given.items()}
    return GivenLimits(payload=section.payload_kg, **listed)
