"""Checks of grips: whether each part has suitable faces for fingers or suction cups."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from planning.cell.robot_model import ToolGrip
from planning.cell.shape import Shape
from planning.cell.workcell import PlacedRobot
from planning.grips.cups import describe_too_wide_cups
from planning.grips.grip import GripRules
from planning.grips.shape_grips import part_grips
from planning.grips.tool_grips import (
    least_thickness,
    robot_rules,
    tool_rules,
)
from planning.transforms import Transform
from twin.checks.finding import (
    CheckContext,
    Finding,
    Findings,
    format_millimetres,
)
from twin.kinds.parts.checks.context import for_part_assemblies
from twin.kinds.parts.ordered_parts import OrderedParts


@for_part_assemblies
def check_grips(subject: CheckContext, parts: OrderedParts) -> Findings:
    """Yield parts that the fingers cannot span, or cannot hold both at the start and in place."""
    assembly, robots = parts.listed, subject.cell.robots
    tools = dict.fromkeys(robot.model.grip for robot in robots)
    for name in dict.fromkeys(assembly.placed):
        part = subject.cell.object(name)
        rules = assembly.handling(name).grips
        widest = max(tool_rules(rules, tool).opening for tool in tools)
        listing = "; ".join(_opens(tool, rules) for tool in tools)
        least = least_thickness(part.shape)
        if least > widest and not rules.suction:
            yield Finding(
                subject.thing_at(name, "size_m"),
                f"no fingers span {name}: its shortest edge is {format_millimetres(least)}, and {listing}",
                error=True,
                code="span",
                parts=(name,),
            )
            continue
        for key, at, where in (
            ("start", part.start, "where it lies at the start"),
            ("goal", assembly.goals[name], "in its place"),
        ):
            why = [_no_face(robot, part.shape, at, rules) for robot in robots]
            if None not in why:
                wide = sorted({words for words in why if words})
                listed = "; ".join([listing, *wide])
                yield Finding(
                    subject.thing_at(name, key),
                    f"no face of {name} can be gripped {where}: {listed}; the tool leans at most"
                    f" {np.degrees(rules.steepest):.0f} deg from assembly.grips.directions; turn the"
                    " part, or allow more of opening_m, directions or steepest_deg"
                    + (", or take a smaller cup" if wide else ""),
                    error=True,
                    code=f"no face at {key}",
                    parts=(name,),
                )


def _no_face(
    robot: PlacedRobot, shape: Shape, at: Transform, rules: GripRules
) -> str | None:
    """Return why a tool finds no face to grip, None if it does."""
    plain, drawn = (
        robot_rules(own, robot) for own in (rules, replace(rules, cup=None))
    )
    for own in (plain, drawn if drawn.lips else plain):
        if not part_grips(shape, at, at, own):
            words = describe_too_wide_cups(shape, at, at, own) if own.suction else None
            return f"{robot.tool or robot.name}: {words}" if words else ""
    return None


def _opens(tool: ToolGrip | None, rules: GripRules) -> str:
    """Return a text on a tool's opening and its source."""
    if tool is None:
        return f"they open to {format_millimetres(rules.opening)} (assembly.grips.opening_m)"
    if tool.opening is None:
        return f"{tool.tool} holds any face"
    if tool.opening[1] == 0.0:
        return f"{tool.tool} holds nothing"
    return f"{tool.tool} opens to {format_millimetres(tool.opening[1])} (cell.tools)"
