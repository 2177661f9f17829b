"""What is committed when something has failed: what is still executed of a plan, and what comes of that."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from planning.cell.workcell import WorldState
from planning.tasks.task import Handling, Task
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.rolling.attempt import with_attempt
from scheduling.rolling.cut import Counts, complete_tasks, cut_after, state_at
from scheduling.rolling.extension import committed_part
from twin.durations.model import NANOSECONDS
from twin.operate.incident import Failure, Incident, Version
from twin.scenario.sections.execution import RecoverySection
from twin.uncertainty.draws import TaskName
from twin.uncertainty.node_times import NodeTimes

Draw = Callable[[TemporalPlanGraph, Mapping[int, TaskName]], NodeTimes]
"""Returns the times of the nodes of a graph, given the names of the draws of tasks."""


def not_executed(tpg: TemporalPlanGraph, incident: Incident) -> list[tuple[int, int]]:
    """Return the nodes that are not executed any more, nor what waits for them."""
    index = tpg.chain_index
    never = [(failure.chain, failure.node) for failure in incident.failures]
    never += [
        (index[robot], incident.released[index[robot]])
        for robot in sorted(incident.out & index.keys())
    ]
    return never


@dataclass(frozen=True)
class Recut:
    """Where a plan is cut, and how it goes on there.

    Attributes:
        steps: whether robots bring their steps to an end before it; their tasks only otherwise.
        aside: whether every robot goes HOME first with what it has to bring to an end, and comes back.
        going: whether robots go on by the plan that there is while it is planned anew.
    """

    steps: bool = False
    aside: bool = False
    going: bool = False

    def counts(
        self, tpg: TemporalPlanGraph, incident: Incident, planning_s: float
    ) -> Counts:
        """Return how many nodes of each chain are committed; planning takes so long [s]."""
        never, released, clock = (
            not_executed(tpg, incident),
            incident.released,
            incident.clock,
        )
        go_on: list[float] = []
        if self.going and clock is not None:
            for k, chain in enumerate(tpg.chains):
                go_on.append(planning_s - clock.left_s(chain, k, released[k]))
        return cut_after(tpg, released, never, steps=self.steps, go_on=go_on)


@dataclass(frozen=True)
class Judged:
    """What is done about failures.

    Attributes:
        words: for people, one entry a failure.
        changes: what becomes of the object of each.
        reopened: steps that are begun anew, with the robots that have nothing to bring to an end in them.
    """

    words: tuple[str, ...]
    changes: tuple[tuple[Handling, ...], ...]
    reopened: dict[int, frozenset[str]]


@dataclass(frozen=True)
class Committed:
    """What is committed at a cut, failed attempts included.

    Attributes:
        committed: its graph.
        robots: of the graph that is cut, in the order of its chains.
        complete: tasks that are complete then.
        state: where everything is then.
        tried: tasks of which all attempts have failed.
        out: robots that are out.
        unwanted: steps that are not wanted any more, unless they have begun.
        judged: what is done about failures.
        ago: how long ago the tasks ended that opened windows of time, by their index [s].
    """

    committed: TemporalPlanGraph
    robots: tuple[str, ...]
    complete: frozenset[int]
    state: WorldState
    tried: tuple[Task, ...]
    out: frozenset[str]
    unwanted: frozenset[int]
    judged: Judged
    ago: Mapping[int, float]

    @property
    def lengths(self) -> dict[str, int]:
        """Number of committed nodes of each robot that has some."""
        return {chain.robot: len(chain) for chain in self.committed.chains}

    def counts(self, union: TemporalPlanGraph) -> Counts:
        """Return how many nodes of each chain of a longer graph are committed."""
        lengths = self.lengths
        return tuple(lengths.get(chain.robot, 0) for chain in union.chains)


def version_of(
    union: TemporalPlanGraph,
    new: TemporalPlanGraph,
    at: Committed,
    drawn: NodeTimes,
    section: RecoverySection,
    begin: float,
    cause: str,
) -> Version:
    """Return a graph that takes the place of one, as it is handed to who executes it.

    Args:
        union: all of it.
        new: what is new only.
        at: what there was before.
        drawn: times of the new nodes.
        section: says how long planning takes in the simulation.
        begin: of planning, in processor time of this process [s].
        cause: why, for people.
    """
    executed_by = tuple(chain.robot for chain in union.chains)
    assert executed_by[: len(at.robots)] == at.robots, "chains keep their numbers"
    return Version(
        union,
        at.counts(union),
        tuple(chain.robot for chain in new.chains),
        drawn,
        round(section.planning_s * NANOSECONDS),
        time.process_time() - begin,
        cause,
        at.judged.words,
    )


def committed_at(
    tpg: TemporalPlanGraph,
    counts: Sequence[int],
    incident: Incident,
    judged: Judged,
) -> Committed:
    """Return what is committed at a cut of a graph."""
    committed = committed_part(tpg, counts)
    for failure, changes in zip(incident.failures, judged.changes, strict=True):
        robot = tpg.chains[failure.chain].robot
        committed = with_attempt(
            committed, tpg, robot, failure.node, changes, missing=failure.missing
        )
    full = [len(chain) for chain in committed.chains]
    return Committed(
        committed,
        tuple(chain.robot for chain in tpg.chains),
        complete_tasks(tpg, counts),
        state_at(committed, full),
        tuple(tried_task(tpg, failure) for failure in incident.failures),
        incident.out,
        incident.unwanted,
        judged,
        incident.ago,
    )


def tried_task(tpg: TemporalPlanGraph, failure: Failure) -> Task:
    """Return the task of which all attempts have failed."""
    return tpg.tasks[int(tpg.chains[failure.chain].task[failure.node])]


def cause_of(
    tpg: TemporalPlanGraph,
    incident: Incident,
    new: range,
    answers: Sequence[str] = (),
) -> str:
    """Return why a graph is extended, for people.

    Args:
        tpg: the graph.
        incident: what has happened.
        new: steps that are planned for the first time.
        answers: of a person who was asked.
    """
    words = []
    for failure in incident.failures:
        task = tried_task(tpg, failure)
        missing = f"{task.object} is not there"
        words.append(missing if failure.missing else f"{task.label} failed")
    words += [f"{name} is out" for name in sorted(incident.out)]
    if incident.unwanted:
        steps = ", ".join(map(str, sorted(incident.unwanted)))
        words.append(f"not wanted any more: steps {steps}")
    if incident.more:
        words.append(
            f"{incident.more} more {'products' if incident.more > 1 else 'product'} wanted"
        )
    if new:
        words.append(f"steps {new[0]} to {new[-1]} come next")
    words += [f"a person was asked: {answer}" for answer in answers]
    return "; ".join(words)
