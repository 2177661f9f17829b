"""Outcome of a search for an assignment that ends sooner than that of the integer program."""

from __future__ import annotations

from dataclasses import dataclass

from planning.tasks.assignment import TaskPlan


@dataclass(frozen=True)
class FoundAssignment:
    """Best assignment that a search found.

    Attributes:
        plan: the assignment; the initial one if none is better.
        start_s: predicted makespan of the initial assignment [s].
        predicted_s: predicted makespan of the best one [s].
        moves: number of evaluated assignments.
    """

    plan: TaskPlan
    start_s: float
    predicted_s: float
    moves: int
