"""Interface of recovery planners, which revise a plan during its execution.

A planner receives the state of the plan and the trigger of replanning, such as a failure. It returns a new state and a
plan revision. The revision appends new nodes to the committed prefix: the nodes that are executed as planned in any
case.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Generic, TypeVar

import numpy as np

from planning.cell.workcell import Workcell
from planning.tasks.task import Task, TaskKind, TimeWindow
from planning.transforms import Indices
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.rolling.extension import committed_subgraph, extend_graph
from scheduling.rolling.supply import deliveries, rename_objects, supply_waits
from twin.durations.nanoseconds import NANOSECONDS
from twin.operations.commitment import (
    CommittedPrefix,
    Draw,
    PlanRevision,
    ReplanTrigger,
    describe_cause,
)
from twin.operations.ledger import LedgerEntries, OperationLedger
from twin.operations.person import AGAIN, Person, with_human_help
from twin.operations.termination import NO_PROGRESS, RevisionMeasure, measure_of
from twin.scenario.sections.scenario import Scenario
from twin.uncertainty.draws import TaskName

_Skill = tuple[int, str]
"""Step and kind of a task."""

Extension = tuple[TemporalPlanGraph, TemporalPlanGraph, CommittedPrefix]
"""An extended graph, its new part, and the committed prefix."""

State = TypeVar("State", bound="RecoveryState")


@dataclass(frozen=True)
class TaskSeeds:
    """Random-number keys per task attempt, so that replanned tasks reuse the draws of the original plan.

    A task that is replanned before its first attempt keeps its key; one that is retried gets a new key.
    So the draws of a step do not depend on when or how often others were planned, and recovery
    strategies can be compared.

    Attributes:
        first: tasks of the first plan, by step and kind.
        skills: step and kind of every task, by index, failed and omitted ones included.
        names: keys of the tasks that do not use their own name as key, by index.
    """

    first: Mapping[_Skill, tuple[Task, ...]]
    skills: Mapping[int, _Skill]
    names: Mapping[int, TaskName]

    @classmethod
    def of(cls, tpg: TemporalPlanGraph) -> TaskSeeds:
        """Return the keys of an initial plan, whose tasks are their own keys."""
        first: dict[_Skill, tuple[Task, ...]] = {}
        for task in tpg.tasks:
            own = task.step, task.kind
            first[own] = (*first.get(own, ()), task)
        return cls(first, {t.index: (t.step, t.kind) for t in tpg.tasks}, {})

    def onward(self, tpg: TemporalPlanGraph, new: int) -> TaskSeeds:
        """Return the keys for a graph whose tasks from an index on are new."""
        before = [t.index for t in tpg.tasks[:new] if t.kind != TaskKind.LEFT_OUT]
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
        return TaskSeeds(self.first, skills, names)


@dataclass(frozen=True)
class RecoveryState:
    """Immutable state of a plan from which it can be extended.

    Attributes:
        tpg: its graph.
        seeds: random-number keys of its tasks.
        ledger: state of steps and objects.
        measure: bound on revisions still to come, see ``termination``; None before the run begins.
    """

    tpg: TemporalPlanGraph
    seeds: TaskSeeds
    ledger: OperationLedger
    measure: RevisionMeasure | None = field(default=None, kw_only=True)


class Planner(ABC, Generic[State]):
    """Recovery of one kind of assembly: maps a state and a replan trigger to a new state and a plan revision.

    Implemented by ``twin.operations.recovery`` for steps, and by ``twin.kinds.construction.recovery``.

    Attributes:
        scenario: its recovery section sets limits and times.
        draw: times of new nodes.
        person: answers questions before a step is abandoned.
        initial: state of the plan with which an operation begins.
    """

    scenario: Scenario
    draw: Draw
    person: Person
    initial: State

    @abstractmethod
    def is_short(self, state: State) -> bool:
        """Return whether the plan of a state lacks wanted steps."""

    def never_begun(self, _state: State) -> Mapping[int, str]:
        """Return wanted steps that were never planned because they are infeasible, by number, with the reason."""
        return {}

    def rush_after(self, _state: State) -> tuple[int, ...]:
        """Return how many products were begun before each one of a rush order that has come in."""
        return ()

    @abstractmethod
    def begun(self, state: State, counts: Sequence[int]) -> set[int]:
        """Return the steps started by given numbers of executed nodes of each chain."""

    @abstractmethod
    def due(self, state: State, released: Sequence[int]) -> bool:
        """Return whether further steps are due for planning."""

    @abstractmethod
    def extend(
        self, state: State, trigger: ReplanTrigger, *, more_steps: bool = True
    ) -> tuple[State, Extension]:
        """Return the next state, still with its graph, and an extended graph that recovers from failures.

        The tasks of the new graph include those of the committed prefix; it begins with the world state at the cut.
        Without ``more_steps``, no steps are added to the planning window.
        """

    def extend_initial(self, trigger: ReplanTrigger) -> tuple[State, Extension]:
        """Return the first state and graph from the initial state, without further steps."""
        return self.extend(self.initial, trigger, more_steps=False)

    @abstractmethod
    def end(
        self, state: State, trigger: ReplanTrigger, why: str
    ) -> tuple[State, Extension]:
        """Return the state with all remaining steps abandoned, and the committed graph alone."""

    def unplanned(self, _state: State) -> int:
        """Return the number of steps not planned yet, 0 if no more will be."""
        return 0

    def new_steps(self, _before: State, _after: State) -> range:
        """Return the numbers of the steps that are planned for the first time."""
        return range(0)

    def with_measure(self, state: State, events: int) -> State:
        """Return a state with its measure, given the number of possible external events."""
        return replace(state, measure=self._measured(state, events))

    def _measured(self, state: State, events: int) -> RevisionMeasure:
        unplanned = self.unplanned(state)
        return measure_of(self.scenario, self.person, state.ledger, events, unplanned)

    def recover(
        self, state: State, trigger: ReplanTrigger
    ) -> tuple[State, PlanRevision]:
        """Return the next state and plan revision after a trigger.

        The given state is not changed, so recovery can be repeated with a later trigger. A
        revision reduces the measure, or is the end of the operation; see ``termination``.

        Args:
            state: state of the executed plan; only the committed nodes of its graph are still executed.
            trigger: events since the last plan.

        Raises:
            UnansweredError: a question to a person is open.
        """
        begin = time.process_time()
        after, found = self.extend(state, trigger)
        new = self.new_steps(state, after)
        measure, before = self._measured(after, trigger.events), state.measure
        if before is not None and not measure.is_below(before):
            after, found = self.end(state, trigger, NO_PROGRESS)
            measure = min(before, self._measured(after, trigger.events))
        union, own, at = found
        executed_by = tuple(chain.robot for chain in union.chains)
        assert executed_by[: len(at.robots)] == at.robots, "chains keep their numbers"
        seeds = state.seeds.onward(union, len(at.committed.tasks))
        after = replace(after, tpg=union, seeds=seeds, measure=measure)
        answers = [ask.answer for ask in after.ledger.asks[len(state.ledger.asks) :]]
        rushed = trigger.rushed - len(self.rush_after(state))
        fresh = replace(trigger, more=trigger.more - state.ledger.more, rushed=rushed)
        planning_s = self.scenario.execution.recovery.planning_s
        version = PlanRevision(
            union,
            at.counts(union),
            tuple(chain.robot for chain in own.chains),
            self.draw(own, seeds.names),
            round(planning_s * NANOSECONDS),
            time.process_time() - begin,
            describe_cause(state.tpg, fresh, new, answers),
            at.triage.words,
        )
        return after, version


def empty_extension(at: CommittedPrefix, cell: Workcell) -> Extension:
    """Return the committed prefix without an extension."""
    nothing = committed_subgraph(at.committed, [0] * len(at.committed.chains))
    waits = np.empty((0, 2), dtype=np.int64)
    return (
        extend_graph(at.committed, nothing, cell, waits, order=at.robots),
        nothing,
        at,
    )


def append_extension(
    at: CommittedPrefix,
    new: TemporalPlanGraph,
    cell: Workcell,
    ledger: LedgerEntries,
    waits: Indices,
    windows: Iterable[TimeWindow] | None = None,
) -> tuple[TemporalPlanGraph, TemporalPlanGraph, Workcell]:
    """Append a new graph to the committed prefix, with the tasks of a person.

    Args:
        at: the committed prefix.
        new: graph that begins with the world state at the cut; its tasks include those of the committed prefix.
        cell: workcell with all objects.
        ledger: state of the operation, with pending replacements and their names.
        waits: edges between new and committed nodes, shape (e, 2).
        windows: time windows, if they differ from those of the prefix.

    Returns:
        The whole graph, the new part, and the cell with replacements.
    """
    before = at.committed.tasks
    new = rename_objects(new, ledger.fresh, len(before))
    new, cell = with_human_help(new, cell, ledger.pending(before))
    own = new.tasks[len(before) :]
    waits = np.concatenate([waits, supply_waits(own, deliveries((*before, *own)))])
    return (
        extend_graph(at.committed, new, cell, waits, windows, order=at.robots),
        new,
        cell,
    )
