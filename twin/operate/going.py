"""What is known of a plan from which it can be gone on, and plans that go on from a cut."""

from __future__ import annotations

from dataclasses import dataclass

from planning.cell.workcell import Workcell
from planning.tasks.assignment import TaskPlan
from planning.tasks.task import StepTasks
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.rolling.forecast import Clock, forecast_s
from twin.operate.committed import Committed
from twin.operate.ledger import Ledger
from twin.operate.luck import Luck


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
        lengths = self.at.lengths
        counts = [lengths.get(chain.robot, 0) for chain in self.union.chains]
        return forecast_s(self.union, counts, clock, planning_s)
