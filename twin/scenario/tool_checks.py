"""Checks of tools that are changed: racks that there are, and one robot for each tool."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from twin.scenario.document.validation import unknown_name
from twin.scenario.document.yaml_text import KeyPath
from twin.scenario.sections.cell import CellSection, LimitsSection
from twin.scenario.sections.parts import PartsSection
from twin.scenario.sections.scenario import Scenario

Found = Iterator[tuple[KeyPath, str]]


def changed_tools(cell: CellSection) -> Mapping[str, str]:
    """Return the tools that are changed, each with the robot that may have it on it."""
    return {name: robot.name for robot in cell.robots for name in robot.tools}


def check_tools(scenario: Scenario) -> Found:
    """Yield what is wrong with tools that are changed, each with its key.

    Args:
        scenario: passed the checks of its single values.
    """
    tools, owners = scenario.cell.tools, dict[str, str]()
    for i, robot in enumerate(scenario.cell.listed):
        at: KeyPath = ("cell", "robots", i)
        if robot.tools and not isinstance(scenario.assembly, PartsSection):
            kind = scenario.assembly.kind
            words = "tools are changed in assemblies of kind 'assembly' only"
            yield (*at, "tools"), f"{words}, and this is a {kind}: give tool"
        if robot.tools and robot.frames:
            yield (
                (*at, "frames"),
                "frames of tools that are changed belong to the tools",
            )
        for k, name in enumerate(robot.tools):
            here: KeyPath = (*at, "tools", k)
            if name not in tools:
                yield here, unknown_name("tool", name, tuple(tools))
            elif tools[name].rack is None:
                yield here, f"{name} has no rack: give cell.tools.{name}.rack"
            elif name in owners:
                words = (
                    f"{name} is a tool of {owners[name]} already: one robot has a tool"
                )
                yield here, f"{words}, describe another one for {robot.name}"
            owners.setdefault(name, robot.name)
    for i, robot in enumerate(scenario.cell.robots):
        if robot.tool in owners:
            key: KeyPath = (
                ("cell", "robots", i) if i < len(scenario.cell.listed) else ()
            )
            at = (*key, "tool") if key else ("cell", "team", "tool")
            words = f"{robot.tool} is changed by {owners[robot.tool]}"
            yield at, f"{words}: describe another one for {robot.name}"
    products = getattr(scenario.assembly, "products", None)
    if owners and products is not None:
        where: KeyPath = ("assembly", "products")
        yield where, "tools are not changed yet where products are made again and again"


def check_tool_speeds(scenario: Scenario) -> Found:
    """Yield limits of the tool's speed where no plan within limits is made, each with its key."""
    if scenario.speed_model == "limits":
        return
    cell = scenario.cell
    sections: list[tuple[KeyPath, LimitsSection]] = [
        (("cell", "robots", i), robot.limits) for i, robot in enumerate(cell.listed)
    ]
    if cell.team is not None:
        sections.append((("cell", "team"), cell.team.limits))
    for at, limits in sections:
        for key in ("tool_speed_m_s", "loaded_tool_speed_m_s"):
            if getattr(limits, key) is not None:
                yield (
                    (*at, "limits", key),
                    f"{key} is kept to with planning.speed_model: limits, and this plan has the speed"
                    f" model {scenario.speed_model!r}",
                )
