"""Reasons why a robot cannot do any step of an assembly of parts."""

from __future__ import annotations

from dataclasses import replace

from planning.cell.workcell import PlacedRobot
from planning.grips.tool_grips import robot_grips
from planning.parts.assembly import PartAssembly, PlacePart, Work
from scheduling.planned_motions import PlannedMotions
from twin.scenario.sections.kind import IdleReason


def why_unable(robot: PlacedRobot, motions: PlannedMotions) -> IdleReason:
    """Return the reason why a robot cannot do any step.

    Args:
        robot: a robot of the cell.
        motions: planned motions of all robots.
    """
    assembly: PartAssembly = motions.assembly
    able = [s for s in assembly.steps if isinstance(s, PlacePart | Work)]
    able = [step for step in able if step.done_by(robot.name)]
    if not able:
        return "not allowed"
    models = [robot.model, *(tool.model for tool in robot.tools)]
    tools = {None, robot.tool, *(tool.name for tool in robot.tools)}
    for step in able:
        if isinstance(step, Work):
            frame = step.process.frame
            fits = step.process.tool in tools
        else:
            frame, part = assembly.frame, motions.cell.object(step.part)
            given = part.shape, part.start, part.start
            grips = assembly.handling(step.part).grips
            outfits = [replace(robot, model=model) for model in models]
            fits = any(robot_grips(own, *given, grips) for own in outfits)
        if fits and any(frame in {"flange", *model.frames} for model in models):
            return "no reach"
    return "tools"
