"""What is known of a plan from which it can be gone on, and how new ones are appended to what is committed."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from planning.cell.workcell import Workcell
from planning.tasks.assignment import TaskPlan
from planning.tasks.task import StepTasks
from planning.tasks.time_window import TimeWindow
from planning.transforms import Indices
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.rolling.extension import extended
from scheduling.rolling.forecast import Clock, forecast_s
from scheduling.rolling.supply import brought_in, renamed, supply_waits
from twin.operate.committed import Committed
from twin.operate.ledger import Ledger
from twin.operate.luck import Luck
from twin.operate.person import with_help


@dataclass(frozen=True)
class Going:
    """What is known of a plan from which it can be gone on.

    Attributes:
        cell: with the objects that have come up.
        task_plan: the choices.
        steps, past: tasks, as of a world.
        luck: of its tasks.
        ledger: what has become of steps and objects.
    """

    cell: Workcell
    task_plan: TaskPlan
    steps: tuple[StepTasks, ...]
    luck: Luck
    ledger: Ledger
    past: tuple[StepTasks, ...] = ()


@dataclass(frozen=True)
class Found:
    """A plan that goes on from a cut.

    Attributes:
        union, new: all of it, and what is new only.
        at: the cut.
        going: what is known of it.
        more: how many steps are given up by it.
    """

    union: TemporalPlanGraph
    new: TemporalPlanGraph
    at: Committed
    going: Going
    more: int

    def end_s(self, clock: Clock | None, planning_s: float) -> float:
        """Return when all of it will be complete, by what is known now [s]."""
        return forecast_s(self.union, self.at.counts(self.union), clock, planning_s)


def appended(
    at: Committed,
    new: TemporalPlanGraph,
    cell: Workcell,
    ledger: Ledger,
    waits: Indices,
    windows: Iterable[TimeWindow] | None = None,
) -> tuple[TemporalPlanGraph, TemporalPlanGraph, Workcell]:
    """Append a new graph to what is committed, with what a person does for it.

    Args:
        at: what is committed.
        new: begins in the world at the cut; its tasks are those before it and then its own.
        cell: with all objects that there are.
        ledger: knows what somebody is to bring, and the names of that.
        waits: what waits for what, of what is new and what is committed, shape (e, 2).
        windows: of time, where they are not those of what is committed.

    Returns:
        All of it, what is new only, and the cell with what is brought.
    """
    before = at.committed.tasks
    new = renamed(new, ledger.fresh, len(before))
    new, cell = with_help(new, cell, ledger.pending(before))
    own = new.tasks[len(before) :]
    waits = np.concatenate([waits, supply_waits(own, brought_in((*before, *own)))])
    return (
        extended(at.committed, new, cell, waits, windows, order=at.robots),
        new,
        cell,
    )
