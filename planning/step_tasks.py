"""The tasks of one assembly step, ready for motion planning."""

from __future__ import annotations

from dataclasses import dataclass

from planning.task_graph import AllowedContact, Task


@dataclass(frozen=True)
class StepTasks:
    """One assembly step, expanded.

    Attributes:
        step: assembly step, from 1.
        tasks: in sequential order; indices are consecutive.
        dependencies: pairs (a, b) of task indices within the step: a before b.
        allowed: contacts allowed during these tasks.
    """

    step: int
    tasks: tuple[Task, ...]
    dependencies: tuple[tuple[int, int], ...]
    allowed: tuple[AllowedContact, ...]
