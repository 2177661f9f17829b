"""Parts that were found beside where they were said to lie: what can be done with them there."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from planning.errors import InfeasibleStepError
from planning.tasks.assignment import AssignmentProblem, PrimaryCandidate, TaskPlan
from planning.tasks.work import AssemblyWork
from planning.transforms import Array, Transform, read_only_copy

Poses = Mapping[str, Transform]
"""Where parts lie that were found elsewhere than at their start, by name."""


def offset_on_surface(pose: Transform, displacement: Array, turn: float) -> Transform:
    """Return a pose that is moved on what it lies on, and turned about the vertical.

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
    """The candidates of an assembly with parts where they were measured; looked for once."""

    _known: dict[tuple[tuple[str, bytes], ...], AssemblyWork | None] = field(
        default_factory=dict
    )

    def of(self, work: AssemblyWork | None, poses: Poses) -> AssemblyWork:
        """Return the work with parts in poses that are allowed."""
        found = self.find(work, poses)
        assert found is not None
        return found

    def find(self, work: AssemblyWork | None, poses: Poses) -> AssemblyWork | None:
        """Return the work with parts in these poses, None where nobody can do something any more."""
        if not poses or work is None:
            return work
        key = _key(poses)
        if key not in self._known:
            try:
                found = work.moved(poses) if work.moved else None
            except InfeasibleStepError:
                found = None
            self._known[key] = found
        return self._known[key]

    def keep(self, work: AssemblyWork, poses: Poses) -> bool:
        """Take note that there are more candidates with parts in these poses, if there are such parts."""
        if poses:
            self._known[_key(poses)] = work
        return bool(poses)

    def allows(self, work: AssemblyWork | None, plan: TaskPlan, poses: Poses) -> bool:
        """Tell whether parts in these poses can be used, and all others as a plan says."""
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


def choices_at_measured_poses(
    work: AssemblyWork, plan: TaskPlan, poses: Poses
) -> TaskPlan:
    """Return choices in which parts that were measured are picked where they are, if need be by another grip."""
    problem = work.problem
    known = set(problem.primaries) if poses else set()
    for choice in plan.choices:
        if choice.object in poses and choice.primary not in known:
            own = _of_step(problem, choice.step)
            first = min(own, key=lambda item: item.robot != choice.primary.robot)
            plan = plan.with_choice(replace(choice, primary=first))
    return plan
