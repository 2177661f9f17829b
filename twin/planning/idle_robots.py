"""Idle robots of a plan: which steps they could do, and why they have no task."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.planned_motions import PlannedMotions
from twin.scenario.sections.kind import AssemblyKind, IdleReason

# Text of each reason in messages, about the steps that the robot could do.
_REASON_TEXTS: dict[IdleReason, str] = {
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
        serves: steps that it could take part in; None if not computed.
        steps: how many steps there are.
    """

    robot: str
    reason: IdleReason
    serves: int | None = None
    steps: int | None = None

    def content(self) -> dict[str, Any]:
        """Return the entry in the summary of a run."""
        return {"reason": self.reason, "serves": self.serves, "steps": self.steps}

    @property
    def message(self) -> str:
        """Sentence about the robot, for people."""
        able = ""
        if self.serves is not None:
            able = f" of {self.steps} steps it can serve {self.serves};"
        return f"{self.robot} gets no task:{able} {_REASON_TEXTS[self.reason]}"


def idle_robots_of_manifest(content: object) -> tuple[IdleRobot, ...]:
    """Return the idle robots in the manifest of a run; damaged entries are skipped."""
    entries = content.items() if isinstance(content, dict) else ()
    return tuple(
        IdleRobot(name, own["reason"], own.get("serves"), own.get("steps"))
        for name, own in entries
        if isinstance(own, dict) and own.get("reason") in [*_REASON_TEXTS]
    )


def find_idle_robots(
    tpg: TemporalPlanGraph, first: PlannedMotions, kind: AssemblyKind
) -> tuple[IdleRobot, ...]:
    """Return the robots without a task, with the reason.

    Args:
        tpg: the plan that was chosen.
        first: the motions of all robots, before those of fewer robots were compared with them.
        kind: of the assembly.
    """
    if first.work is None:
        return tuple(_idle_builder(name, first, kind) for name in tpg.idle_robots())
    found, problem = [], first.work.problem
    for name in tpg.idle_robots():
        steps = {c.step for c in problem.primaries if name in (c.robot, c.partner)}
        steps |= {c.step for c in problem.supports if c.robot == name}
        reason: IdleReason = "balance"
        if not steps:
            reason = kind.why_unable(tpg.cell.robot(name), first)
        elif any(task.robot == name for task in first.motion_plan.tasks):
            reason = "makespan"
        found.append(IdleRobot(name, reason, len(steps), len(problem.steps)))
    return tuple(found)


def _idle_builder(name: str, first: PlannedMotions, kind: AssemblyKind) -> IdleRobot:
    """Return why a robot is idle where tasks and motions are planned together."""
    able, steps = kind.steps_served(name, first)
    reason: IdleReason = "search" if able else "no reach"
    return IdleRobot(name, reason, able, steps)
