"""Robots to which a plan gives no task: what they could do, and why they get nothing."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

from planning.cell.workcell import PlacedRobot
from planning.grips.tool_grips import robot_grips
from planning.parts.assembly import PartAssembly, PlacePart, Work
from scheduling.graph.task_edges import idle_robots
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.planning.kind import PlannedMotions

IdleReason = Literal[
    "no reach", "tools", "not allowed", "makespan", "balance", "search", "unknown"
]
"""Why a robot gets no task: it reaches none, has no tool for one, or the scenario names others for all; the plan does
not end sooner with it; the assignment has others do them at less cost; the search of a construction found a plan
without it; or it is not known, as of a plan that was read."""

_WORDS: dict[IdleReason, str] = {
    "no reach": "it reaches none of them",
    "tools": "it has no tool for any of them",
    "not allowed": "the scenario gives all of them to others",
    "makespan": "the plan does not end sooner with it",
    "balance": "the assignment gives them to others at less cost",
    "search": "the search found a plan without it",
    "unknown": "why is not known",
}


@dataclass(frozen=True)
class IdleRobot:
    """A robot to which a plan gives no task.

    Attributes:
        robot: its name.
        reason: why it gets none.
        serves: steps in which it could do something; None where nobody looked.
        steps: how many steps there are.
    """

    robot: str
    reason: IdleReason
    serves: int | None = None
    steps: int | None = None

    def content(self) -> dict[str, Any]:
        """Return what the summary of a run has of it."""
        return {"reason": self.reason, "serves": self.serves, "steps": self.steps}

    @property
    def message(self) -> str:
        """What it is, for people."""
        able = ""
        if self.serves is not None:
            able = f" of {self.steps} steps it can serve {self.serves};"
        return f"{self.robot} gets no task:{able} {_WORDS[self.reason]}"


def find_idle(tpg: TemporalPlanGraph, first: PlannedMotions) -> tuple[IdleRobot, ...]:
    """Return the robots that get no task, and why.

    Args:
        tpg: the plan that was chosen.
        first: the motions of all robots, before those of fewer robots were compared with them.
    """
    found = []
    for name in idle_robots(tpg):
        if first.work is None:
            found.append(IdleRobot(name, "search"))
            continue
        problem = first.work.problem
        steps = {c.step for c in problem.primaries if name in (c.robot, c.partner)}
        steps |= {c.step for c in problem.supports if c.robot == name}
        reason: IdleReason = "balance"
        if not steps:
            reason = _why_none(tpg.cell.robot(name), first)
        elif any(task.robot == name for task in first.motion_plan.tasks):
            reason = "makespan"
        found.append(IdleRobot(name, reason, len(steps), len(problem.steps)))
    return tuple(found)


def _why_none(robot: PlacedRobot, first: PlannedMotions) -> IdleReason:
    """Return why a robot can serve no step."""
    assembly = first.assembly
    if not isinstance(assembly, PartAssembly):
        # Moves are of robots by their names.
        return "not allowed" if first.work and not first.work.assembly else "no reach"
    able = [s for s in assembly.steps if isinstance(s, PlacePart | Work)]
    able = [step for step in able if step.done_by(robot.name)]
    if not able:
        return "not allowed"
    models = [robot.model, *(tool.model for tool in robot.tools)]
    tools = {None, robot.tool, *(tool.name for tool in robot.tools)}
    for step in able:
        work = step.process if isinstance(step, Work) else None
        frame = assembly.frame if work is None else work.frame
        own = [m for m in models if frame in {"flange", *m.frames}]
        if work is not None and own and work.tool in tools:
            return "no reach"
        if isinstance(step, PlacePart):
            part = first.cell.object(step.part)
            rules = assembly.handling(step.part).grips
            given = part.shape, part.start, part.start, rules
            if any(robot_grips(replace(robot, model=m), *given) for m in own):
                return "no reach"
    return "tools"
