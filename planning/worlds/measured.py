"""Feasibility of candidates for parts whose measured poses differ from their nominal poses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from planning.errors import InfeasibleStepError
from planning.tasks.assembly import Assembly
from planning.tasks.assignment import AssignmentProblem, PrimaryCandidate, TaskPlan
from planning.transforms import Array, Transform, read_only_copy

Poses = Mapping[str, Transform]
"""Measured poses of parts that are not at their start poses, by name."""


def offset_on_surface(pose: Transform, displacement: Array, turn: float) -> Transform:
    """Return a pose displaced within its support plane, and rotated about the vertical.

    Args:
        pose: in the world.
        displacement: along x and y of the world, shape (2,) [m].
        turn: [rad].
    """
    out = np.array(pose)
    cos, sin = np.cos(turn), np.sin(turn)
    out[:2, :3] = np.array([[cos, -sin], [sin, cos]]) @ pose[:2, :3]
    out[:2, 3] += displacement
    return read_only_copy(out)


@dataclass
class MeasuredWork:
    """Cache of the candidates of an assembly for measured part poses."""

    _known: dict[tuple[tuple[str, bytes], ...], Assembly | None] = field(
        default_factory=dict
    )

    def of(self, work: Assembly | None, poses: Poses) -> Assembly:
        """Return the work with parts at allowed poses."""
        found = self.find(work, poses)
        assert found is not None
        return found

    def find(self, work: Assembly | None, poses: Poses) -> Assembly | None:
        """Return the work with parts at these poses, None where a step becomes infeasible."""
        if not poses or work is None:
            return work
        key = _key(poses)
        if key not in self._known:
            try:
                found = work.with_poses(poses)
            except InfeasibleStepError:
                found = None
            self._known[key] = found
        return self._known[key]

    def keep(self, work: Assembly, poses: Poses) -> bool:
        """Record that these poses have further candidates, if such parts exist."""
        if poses:
            self._known[_key(poses)] = work
        return bool(poses)

    def allows(self, work: Assembly | None, plan: TaskPlan, poses: Poses) -> bool:
        """Tell whether parts are usable at these poses, with all others as planned."""
        found = self.find(work, poses)
        if found is None:
            return False
        problem = found.problem
        primaries, supports = set(problem.primaries), set(problem.supports)
        return all(
            any(item.object == choice.object for item in _of_step(problem, choice.step))
            if choice.object in poses
            else choice.primary in primaries
            and (choice.support is None or choice.support in supports)
            for choice in plan.choices
        )


def _key(poses: Poses) -> tuple[tuple[str, bytes], ...]:
    return tuple((name, poses[name].tobytes()) for name in sorted(poses))


def _of_step(problem: AssignmentProblem, step: int) -> list[PrimaryCandidate]:
    return [problem.primaries[k] for k in problem.primaries_of.get(step, ())]


def choices_at_measured_poses(work: Assembly, plan: TaskPlan, poses: Poses) -> TaskPlan:
    """Return choices that pick measured parts where they are, with another grip if needed."""
    problem = work.problem
    known = set(problem.primaries) if poses else set()
    for choice in plan.choices:
        if choice.object in poses and choice.primary not in known:
            own = _of_step(problem, choice.step)
            first = min(own, key=lambda item: item.robot != choice.primary.robot)
            plan = plan.with_choice(replace(choice, primary=first))
    return plan
