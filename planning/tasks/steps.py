"""The tasks of one assembly step, ready for motion planning."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

from planning.cell.workcell import CellObject, Workcell
from planning.tasks.task import AllowedContact, Task


@dataclass(frozen=True)
class StepTasks:
    """One assembly step, expanded.

    Attributes:
        step: assembly step, from 1.
        tasks: in sequential order; indices are consecutive.
        dependencies: pairs (a, b) of task indices within the step: a before b.
        allowed: contacts allowed during these tasks.
        objects: what comes up in these tasks, such as the next brick of a feeding station.
    """

    step: int
    tasks: tuple[Task, ...]
    dependencies: tuple[tuple[int, int], ...]
    allowed: tuple[AllowedContact, ...]
    objects: tuple[CellObject, ...] = ()


def cell_with_steps(cell: Workcell, steps: Iterable[StepTasks]) -> Workcell:
    """Return the cell with the objects that come up in some steps."""
    coming = tuple(item for step in steps for item in step.objects)
    return replace(cell, objects=(*cell.objects, *coming)) if coming else cell
