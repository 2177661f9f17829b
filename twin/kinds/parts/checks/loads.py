"""Checks of loads: tools and parts too heavy for their robots."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from planning.cell.workcell import (
    CellObject,
    PlacedRobot,
)
from planning.handling.tool_changes import with_each_tool
from twin.checks.finding import (
    CheckContext,
    Finding,
    Findings,
    name_in_file,
)
from twin.kinds.parts.checks.context import for_part_assemblies
from twin.kinds.parts.ordered_parts import OrderedParts
from twin.kinds.parts.section import PartsSection

_NAMED = 4
"""How many parts without a mass are named."""


@for_part_assemblies
def check_payloads(subject: CheckContext, parts: OrderedParts) -> Findings:
    """Yield tools and parts too heavy for their robots, and unknown masses.

    A part that no robot which may place it carries is an error; a tool that is too heavy by itself may
    have a wrong mass in its description. Masses count where the scenario gives a payload: then one
    that is not specified counts as none.
    """
    section = parts.section
    robots = list(with_each_tool(subject.built.robots))
    yield from _heavy_tools(subject, robots)
    for part in subject.cell.objects:
        yield from _too_heavy(subject, section, part, robots)
    given = _given(subject)
    if not given:
        return
    yield from _light_tools(subject, robots, given)
    moved = set(section.taken)
    light = [p.name for p in section.parts if p.name in moved and not p.mass_is_given]
    if light:
        more = f" and {len(light) - _NAMED} more" if len(light) > _NAMED else ""
        has = "have" if len(light) > 1 else "has"
        yield Finding(
            subject.thing_at(light[0], "name"),
            f"{', '.join(light[:_NAMED])}{more} {has} no mass, so that of what {', '.join(given)} may carry"
            " (limits.payload_kg) the tool alone counts: give mass_kg, or density_kg_m3",
        )


def _given(subject: CheckContext) -> dict[str, float]:
    """Return the payloads that the scenario gives, by robot [kg]."""
    cell = subject.scenario.cell
    return {
        robot.name: robot.limits.payload_kg
        for robot in cell.robots
        if robot.limits.payload_kg is not None
    }


def _heavy_tools(subject: CheckContext, robots: Sequence[PlacedRobot]) -> Findings:
    for robot in robots:
        drives = robot.model.drives
        if drives is None or drives.tool_mass <= drives.payload:
            continue
        yield Finding(
            subject.robot_at(robot.name, "limits", "tool", "model"),
            f"{_tool(robot)} of {robot.name} weighs {drives.tool_mass:.3g} kg, and {robot.name} may carry"
            f" {drives.payload:g} kg with it (limits.payload_kg): one of the two is wrong; tools.NAME.mass_kg"
            " says what a tool weighs where its description does not know",
        )


def _light_tools(
    subject: CheckContext, robots: Sequence[PlacedRobot], given: dict[str, float]
) -> Findings:
    seen: set[str] = set()
    for robot in robots:
        drives, name = robot.model.drives, robot.tool
        known = name is None or name not in subject.scenario.cell.tools or name in seen
        if known or robot.name not in given or drives is None or drives.tool_mass > 0.0:
            continue
        assert name is not None
        seen.add(name)
        yield Finding(
            ("cell", "tools", name),
            f"{name} has no mass, so that of the {given[robot.name]:g} kg that {robot.name} may carry, its tool"
            f" included, all is left for parts: give cell.tools.{name}.mass_kg",
        )


def _too_heavy(
    subject: CheckContext,
    section: PartsSection,
    part: CellObject,
    robots: Sequence[PlacedRobot],
) -> Findings:
    for step in section.steps:
        if step.place != name_in_file(part.name, {step.place or ""}):
            continue
        free = dict(_spare(robots, step.robots))
        if part.mass > max(free.values(), default=math.inf):
            listing = ", ".join(f"{name} {left:.3g} kg" for name, left in free.items())
            who = "no robot" if step.robots is None else "no robot that may place it"
            yield Finding(
                subject.thing_at(part.name, "mass_kg"),
                f"{part.name} weighs {part.mass:g} kg, which {who} carries beside its tool ({listing};"
                " limits.payload_kg)",
                error=True,
                code="heavy",
                parts=(part.name,),
            )
            return


def _spare(
    robots: Sequence[PlacedRobot], allowed: Sequence[str] | None
) -> Iterator[tuple[str, float]]:
    """Yield the payload of robots after their (lightest) tool [kg]."""
    most: dict[str, float] = {}
    for robot in robots:
        if allowed is None or robot.name in allowed:
            drives = robot.model.drives
            spare = math.inf if drives is None else drives.spare
            most[robot.name] = max(most.get(robot.name, 0.0), spare)
    yield from most.items()


def _tool(robot: PlacedRobot) -> str:
    return f"the tool {robot.tool}" if robot.tool else "the tool"
