"""Outcome of a search for an assignment that ends sooner than that of the integer program."""

from __future__ import annotations

from dataclasses import dataclass

from planning.tasks.assignment import TaskPlan


@dataclass(frozen=True)
class FoundAssignment:
    """Assignments that the runs of a search found.

    Attributes:
        plans: different assignments with their predicted makespans [s], shortest first; the initial one
            where none is better.
        start_s: predicted makespan of the initial assignment [s].
        moves: number of evaluated assignments.
    """

    plans: tuple[tuple[float, TaskPlan], ...]
    start_s: float
    moves: int
