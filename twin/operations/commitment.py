"""Replan triggers, plan revisions and committed prefixes.

A replan trigger is an event after which a plan is revised, such as a failure. A cut divides the nodes of the plan: the
committed prefix before the cut is executed as planned, and the rest is planned again.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import count

from planning.cell.workcell import WorldState
from planning.tasks.task import Handling, Task
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.rolling.cut import Counts, complete_tasks, cut_after, world_state_after
from scheduling.rolling.extension import committed_subgraph, with_attempt
from scheduling.rolling.forecast import Clock
from twin.uncertainty.draws import TaskName
from twin.uncertainty.node_times import NodeTimes

Draw = Callable[[TemporalPlanGraph, Mapping[int, TaskName]], NodeTimes]
"""Returns the times of the nodes of a graph, given the names of the draws of tasks."""


@dataclass(frozen=True)
class Failure:
    """A skill that has failed for good.

    Attributes:
        chain, node: its first node.
        lost: whether its object is lost.
        missing: whether it was not attempted because its object was missing.
    """

    chain: int
    node: int
    lost: bool = False
    missing: bool = False


@dataclass(frozen=True)
class ReplanTrigger:
    """Trigger of a plan revision: all events since the last plan.

    Attributes:
        failures: skills that failed.
        out: robots that are out.
        unwanted: steps that are not wanted any more, by number.
        released: number of released nodes of each chain.
        ago: how long ago the tasks ended that opened windows of time, by their index [s].
        clock: the execution so far; None without time.
        due: whether nothing has happened but that more is to be planned.
        more: products that have been ordered since the beginning.
        rushed: products of rush orders that have come in, likewise.
        events: events from outside that can still occur, see ``termination``.
    """

    failures: tuple[Failure, ...]
    out: frozenset[str]
    unwanted: frozenset[int]
    released: tuple[int, ...]
    ago: Mapping[int, float] = field(default_factory=dict)
    clock: Clock | None = None
    due: bool = False
    more: int = 0
    rushed: int = 0
    events: int = 0


@dataclass(frozen=True)
class PlanRevision:
    """Revision of a plan, which replaces the executed graph.

    Attributes:
        tpg: the committed prefix and the new nodes.
        counts: number of committed nodes of each chain.
        new: robots that have new nodes.
        times: of the new nodes, an entry for each of these robots.
        planning_ns: how long planning it takes in the simulation [ns].
        cpu_s: processor seconds that planning it took.
        cause: why, for people.
        recovered: outcome of each failure, for people; one entry each.
    """

    tpg: TemporalPlanGraph
    counts: tuple[int, ...]
    new: tuple[str, ...]
    times: NodeTimes
    planning_ns: int
    cpu_s: float
    cause: str
    recovered: tuple[str, ...] = ()


def cut_at(
    tpg: TemporalPlanGraph,
    trigger: ReplanTrigger,
    *,
    steps: bool = True,
    continue_s: Sequence[float] = (),
) -> Counts:
    """Return the number of committed nodes of each chain at a trigger, see ``cut_after``."""
    index = tpg.chain_index
    never = [(failure.chain, failure.node) for failure in trigger.failures]
    never += [
        (index[robot], trigger.released[index[robot]])
        for robot in sorted(trigger.out & index.keys())
    ]
    return cut_after(tpg, trigger.released, never, steps=steps, continue_s=continue_s)


def executable_lengths(tpg: TemporalPlanGraph, trigger: ReplanTrigger) -> Counts:
    """Return the number of nodes of each chain that can be executed without a new plan."""
    return cut_at(tpg, trigger, continue_s=[math.inf] * len(tpg.chains))


@dataclass(frozen=True)
class CutPolicy:
    """Policy of where a plan is cut and extended.

    Attributes:
        steps: whether robots bring their steps to an end before it; their tasks only otherwise.
        evade: whether every robot first finishes its task, goes HOME and returns.
        continuing: whether robots continue the old plan during replanning.
    """

    steps: bool = False
    evade: bool = False
    continuing: bool = False

    def counts(
        self, tpg: TemporalPlanGraph, trigger: ReplanTrigger, planning_s: float
    ) -> Counts:
        """Return the number of committed nodes of each chain, given the planning time [s]."""
        clock, continue_s = trigger.clock, list[float]()
        if self.continuing and clock is not None:
            left = map(clock.left_s, tpg.chains, count(), trigger.released)
            continue_s = [planning_s - seconds for seconds in left]
        return cut_at(tpg, trigger, steps=self.steps, continue_s=continue_s)


@dataclass(frozen=True)
class TriageResult:
    """Decisions about failures.

    Attributes:
        words: for people, one entry per failure.
        changes: change of the object of each.
        reopened: steps that are started again, with the robots that have no task to finish in them.
    """

    words: tuple[str, ...]
    changes: tuple[tuple[Handling, ...], ...]
    reopened: dict[int, frozenset[str]]


@dataclass(frozen=True)
class CommittedPrefix:
    """Prefix of a plan that is committed at a cut, failed attempts included.

    Attributes:
        committed: its graph.
        robots: of the graph that is cut, in the order of its chains.
        complete: tasks that are complete then.
        state: where everything is then.
        tried: tasks of which all attempts have failed.
        out: robots that are out.
        unwanted: steps that are not wanted any more, unless they have begun.
        triage: decisions about failures.
        ago: how long ago the tasks ended that opened windows of time, by their index [s].
    """

    committed: TemporalPlanGraph
    robots: tuple[str, ...]
    complete: frozenset[int]
    state: WorldState
    tried: tuple[Task, ...]
    out: frozenset[str]
    unwanted: frozenset[int]
    triage: TriageResult
    ago: Mapping[int, float]

    @property
    def lengths(self) -> dict[str, int]:
        """Number of committed nodes of each robot that has any."""
        return {chain.robot: len(chain) for chain in self.committed.chains}

    def counts(self, union: TemporalPlanGraph) -> Counts:
        """Return the number of committed nodes of each chain of a longer graph."""
        lengths = self.lengths
        return tuple(lengths.get(chain.robot, 0) for chain in union.chains)


def committed_at(
    tpg: TemporalPlanGraph,
    counts: Sequence[int],
    trigger: ReplanTrigger,
    triage: TriageResult,
) -> CommittedPrefix:
    """Return the committed prefix at a cut of a graph."""
    committed = committed_subgraph(tpg, counts)
    for failure, changes in zip(trigger.failures, triage.changes, strict=True):
        robot = tpg.chains[failure.chain].robot
        committed = with_attempt(
            committed, tpg, robot, failure.node, changes, missing=failure.missing
        )
    full = [len(chain) for chain in committed.chains]
    return CommittedPrefix(
        committed,
        tuple(chain.robot for chain in tpg.chains),
        complete_tasks(tpg, counts),
        world_state_after(committed, full),
        tuple(failed_task(tpg, failure) for failure in trigger.failures),
        trigger.out,
        trigger.unwanted,
        triage,
        trigger.ago,
    )


def failed_task(tpg: TemporalPlanGraph, failure: Failure) -> Task:
    """Return the task whose attempts have all failed."""
    return tpg.task_at(failure.chain, failure.node)


def describe_cause(
    tpg: TemporalPlanGraph,
    trigger: ReplanTrigger,
    new: range,
    answers: Sequence[str] = (),
) -> str:
    """Return the reason for a revision, for people.

    Args:
        tpg: the graph.
        trigger: the events since the last plan.
        new: steps that are planned for the first time.
        answers: answers of a person to questions.
    """
    words = []
    for failure in trigger.failures:
        task = failed_task(tpg, failure)
        missing = f"{task.object} is not there"
        words.append(missing if failure.missing else f"{task.label} failed")
    words += [f"{name} is out" for name in sorted(trigger.out)]
    if trigger.unwanted:
        steps = ", ".join(map(str, sorted(trigger.unwanted)))
        words.append(f"not wanted any more: steps {steps}")
    for wanted, what in ((trigger.more, "more"), (trigger.rushed, "rush")):
        if wanted:
            products = "products" if wanted > 1 else "product"
            words.append(f"{wanted} {what} {products} wanted")
    if new:
        words.append(f"steps {new[0]} to {new[-1]} come next")
    words += [f"a person was asked: {answer}" for answer in answers]
    return "; ".join(words)
