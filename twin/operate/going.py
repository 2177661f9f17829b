"""What is known of a plan from which it can be gone on, who plans that, and how it is appended to what is committed."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np

from planning.cell.workcell import Workcell
from planning.tasks.assignment import TaskPlan
from planning.tasks.task import LEFT_OUT, StepTasks, Task, TimeWindow
from planning.transforms import Indices
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.rolling.extension import committed_part, extended
from scheduling.rolling.forecast import Clock, forecast_s
from scheduling.rolling.supply import brought_in, renamed, supply_waits
from twin.durations.model import NANOSECONDS
from twin.operate.committed import Committed, Draw, Incident, Version, cause_of
from twin.operate.person import AGAIN, Ask, Ledger, Person, with_help
from twin.operate.termination import NO_PROGRESS, Measure, measure_of
from twin.scenario.sections.scenario import Scenario
from twin.uncertainty.draws import TaskName

_Skill = tuple[int, str]
"""Step and kind of a task."""


@dataclass(frozen=True)
class Luck:
    """Names of the draws of all tasks of an operation: a task has the luck of the same try at the same skill of its step.

    Draws are named by tasks. A task that is planned again before anybody has tried it keeps the name, and so the
    luck, that it had in the first plan; one that is tried once more has a name of its own. So what happens to a
    step does not depend on when or how often others were planned, and ways to recover can be compared.

    Attributes:
        first: tasks of the first plan, by step and kind.
        skills: step and kind of every task, by index: those of what failed or is left out, too.
        names: of the draws of tasks whose names are not their own, by index.
    """

    first: Mapping[_Skill, tuple[Task, ...]]
    skills: Mapping[int, _Skill]
    names: Mapping[int, TaskName]

    @classmethod
    def of(cls, tpg: TemporalPlanGraph) -> Luck:
        """Return the luck of a first plan, whose tasks name their draws themselves."""
        first: dict[_Skill, tuple[Task, ...]] = {}
        for task in tpg.tasks:
            own = task.step, task.kind
            first[own] = (*first.get(own, ()), task)
        return cls(first, {t.index: (t.step, t.kind) for t in tpg.tasks}, {})

    def onward(self, tpg: TemporalPlanGraph, new: int) -> Luck:
        """Return the names for a graph whose tasks from an index on are new."""
        before = [t.index for t in tpg.tasks[:new] if t.kind != LEFT_OUT]
        tries = Counter(self.skills[index] for index in before)
        skills = {index: self.skills[index] for index in range(new)}
        names = {k: name for k, name in self.names.items() if k < new}
        for task in tpg.tasks[new:]:
            own = task.step, task.kind
            skills[task.index] = own
            if planned := self.first.get(own):
                again = max(tries[own] - len(planned) + 1, 0)
                model = planned[min(tries[own], len(planned) - 1)]
                names[task.index] = (model.robot, model.index + again * AGAIN)
            tries[own] += 1
        return Luck(self.first, skills, names)


@dataclass(frozen=True)
class Known:
    """What is known of a plan from which it can be gone on, whatever is made.

    Attributes:
        luck: of its tasks.
        ledger: what has become of steps and objects.
    """

    luck: Luck
    ledger: Ledger


@dataclass(frozen=True)
class Going(Known):
    """What is known of the plan of an assembly.

    Attributes:
        cell: with the objects that have come up.
        task_plan: the choices.
        steps, past: tasks, as of a world.
    """

    cell: Workcell
    task_plan: TaskPlan
    steps: tuple[StepTasks, ...]
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


State = TypeVar("State", bound=Known)

Extension = tuple[TemporalPlanGraph, TemporalPlanGraph, Committed]
"""All of a graph that goes on, what is new only, and what there was before."""


class Planner(ABC, Generic[State]):
    """Plans what is left while a plan is executed.

    What it knows is that of the graph that is executed; of one that is planned and does not take its place,
    because more happens before, nothing is kept.
    """

    scenario: Scenario
    draw: Draw
    person: Person
    _executed: State
    _planned: State
    _measure: Measure | None = None
    _measure_planned: Measure | None = None

    @property
    def given_up(self) -> Mapping[int, str]:
        """Steps that are not done any more in what is executed, by number, with the reason."""
        return self._executed.ledger.given_up

    @property
    def never_begun(self) -> Mapping[int, str]:
        """Steps that are wanted and were never planned, as nobody can do them, likewise."""
        return {}

    @property
    def dropped(self) -> Mapping[int, str]:
        """Steps that are not wanted any more in what is executed, or rest on one, likewise."""
        return self._executed.ledger.dropped

    @property
    def asks(self) -> tuple[Ask, ...]:
        """What a person was asked for what is executed."""
        return self._executed.ledger.asks

    @property
    @abstractmethod
    def short(self) -> bool:
        """Whether less is made, by what is executed, than is wanted."""

    @abstractmethod
    def begun(self, tpg: TemporalPlanGraph, counts: Sequence[int]) -> set[int]:
        """Return the steps that have begun once so many nodes of each chain are executed."""

    @abstractmethod
    def due(self, tpg: TemporalPlanGraph, released: Sequence[int]) -> bool:
        """Tell whether it is time to plan more of what is executed, though nothing has failed."""

    @abstractmethod
    def plan(self, tpg: TemporalPlanGraph, incident: Incident) -> Version:
        """Return what is to take the place of a graph; nothing beyond its counts is executed any more.

        It may be asked again for the same graph, with more that has happened, before it takes its place.
        """

    @abstractmethod
    def plan_alone(self, tpg: TemporalPlanGraph, incident: Incident) -> Extension:
        """Return what goes on; what was given up is told from then on.

        The tasks of the new graph are those before it and then its own; it begins in the world at the cut.
        """

    @abstractmethod
    def _unplanned(self, state: State) -> int:
        """Return how many steps are not planned yet, 0 where no more are to be."""

    @abstractmethod
    def _ended(self, tpg: TemporalPlanGraph, incident: Incident, why: str) -> Extension:
        """Give up every step that is not done, and return what is committed, after which nothing comes."""

    def begin(self, events: int) -> None:
        """Measure the plan with which an operation begins; so many events from outside can occur."""
        self._measure = self._measured(self._executed, events)

    def swapped(self) -> None:
        """Take note that what was planned last has taken its place."""
        self._executed, self._measure = self._planned, self._measure_planned

    def _measured(self, state: State, events: int) -> Measure:
        unplanned = self._unplanned(state)
        return measure_of(self.scenario, self.person, state.ledger, events, unplanned)

    def _terminating(
        self, tpg: TemporalPlanGraph, incident: Incident, found: Extension
    ) -> Extension:
        """Return a revision that reduces the measure, or the end of the operation; see ``termination``."""
        measure, before = self._measured(self._planned, incident.events), self._measure
        if before is not None and not measure.is_below(before):
            found = self._ended(tpg, incident, NO_PROGRESS)
            measure = min(before, self._measured(self._planned, incident.events))
        self._measure_planned = measure
        return found

    def _version(
        self,
        tpg: TemporalPlanGraph,
        incident: Incident,
        found: Extension,
        begin: float,
        new: range = range(0),
    ) -> Version:
        """Return what was planned last as it is handed to who executes it.

        Args:
            tpg: what has been executed so far.
            incident: what has happened.
            found: what goes on.
            begin: of planning, in processor time of this process [s].
            new: steps that come next.
        """
        union, own, at = self._terminating(tpg, incident, found)
        executed_by = tuple(chain.robot for chain in union.chains)
        assert executed_by[: len(at.robots)] == at.robots, "chains keep their numbers"
        luck = self._executed.luck.onward(union, len(at.committed.tasks))
        self._planned = replace(self._planned, luck=luck)
        answers = [ask.answer for ask in self._planned.ledger.asks[len(self.asks) :]]
        fresh = replace(incident, more=incident.more - self._executed.ledger.more)
        planning_s = self.scenario.execution.recovery.planning_s
        return Version(
            union,
            at.counts(union),
            tuple(chain.robot for chain in own.chains),
            self.draw(own, luck.names),
            round(planning_s * NANOSECONDS),
            time.process_time() - begin,
            cause_of(tpg, fresh, new, answers),
            at.judged.words,
        )


def nothing_new(at: Committed, cell: Workcell) -> Extension:
    """Return what is committed, after which nothing comes."""
    nothing = committed_part(at.committed, [0] * len(at.committed.chains))
    waits = np.empty((0, 2), dtype=np.int64)
    return extended(at.committed, nothing, cell, waits, order=at.robots), nothing, at


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
