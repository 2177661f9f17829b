"""Replays: the same draws executed again with a lever shortened, by longest paths or events."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np

from planning.tasks.task import TRANSIT
from planning.transforms import Indices
from scheduling.graph.dispatcher import Dispatcher, earliest_times
from scheduling.graph.task_edges import with_barriers, with_turns
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.motion_times import at_full_speed, is_driven
from twin.durations import Nanoseconds
from twin.engine.bulk.bulk_engine import BulkEngine
from twin.engine.bulk.max_plus import (
    Completions,
    Past,
    PrecedenceArrays,
    completions,
    end_times,
    explain,
    makespans,
    makespans_of_ends,
    policy_graph,
)
from twin.engine.driven import DrivenExecution
from twin.engine.execution_model import ExecutionModel, Messages
from twin.engine.processes import Execution
from twin.study.gains.draws import Draws, shortened
from twin.study.gains.lever import Lever
from twin.study.replications.workload import Workload
from twin.uncertainty.contraction import Contraction, contract
from twin.uncertainty.disturbances import Disturbances
from twin.uncertainty.halts import sample_halts
from twin.uncertainty.node_times import (
    NodeTimes,
    NodeTimeSampler,
    SegmentTimes,
    Standstill,
)
from twin.uncertainty.skill_durations import nominal_ns


class Replay(Protocol):
    """Replications of one workload that can be executed again with something shortened.

    Attributes:
        tpg: what is executed, contracted where that changes nothing.
        graph: what must wait for what.
        draws: what every node takes.
        eases_waits: whether waits can be shortened.
    """

    tpg: TemporalPlanGraph
    graph: PrecedenceArrays
    draws: Draws
    eases_waits: bool

    def base(self) -> Completions:
        """Return what came of the replications as they were drawn."""
        ...

    def makespans_ns(self, lever: Lever, share: float) -> Nanoseconds:
        """Return when all work is done with a lever a share shorter, shape (r,) [ns]."""
        ...


def replay_of(load: Workload, numbers: Indices) -> Replay:
    """Return the quickest replay that gives the study's nanoseconds.

    Args:
        load: the work of one cell.
        numbers: of the replications.
    """
    if not load.reasons:
        if is_driven(load.tpg):
            return DrivenReplay(load, numbers)
        return PathReplay(load, numbers)
    return (
        EventReplay(load, numbers)
        if needs_events(load)
        else MessageReplay(load, numbers)
    )


def until_work_is_done(
    tpg: TemporalPlanGraph, graph: PrecedenceArrays
) -> PrecedenceArrays:
    """Return the graph of runs that are over when all work is done.

    Work is all but transits on which nothing depends: a robot that goes HOME after its last skill has
    done its part. In a plan without skills, all is work.

    Args:
        tpg: the plan, contracted or not.
        graph: what must wait for what in it.
    """
    works = np.array([task.kind != TRANSIT or task.goal for task in tpg.tasks])
    last = np.full(len(tpg.chains), -1, dtype=np.int64)
    for k, chain in enumerate(tpg.chains):
        own = np.flatnonzero(works[chain.task])
        if len(own):
            last[k] = graph.first[k] + own[-1]
    return graph._replace(last=last) if np.any(last >= 0) else graph


def needs_events(load: Workload) -> bool:
    """Tell whether a plan can be executed again by the event engine only."""
    model = load.execution
    return bool(load.reasons) and (
        is_driven(load.tpg)
        or model.disturbances.at_absolute_times
        or model.policy == "synchronous"
    )


def replay_cost(load: Workload) -> int:
    """Return how many nodes and edges are looked at in one replication."""
    tpg = contract(load.tpg).tpg if _in_segments(load) else load.tpg
    return sum(len(chain) for chain in tpg.chains) + len(tpg.edges)


def _in_segments(load: Workload) -> bool:
    """Tell whether joined nodes give the same times: no messages, no planned clock."""
    by_clock = needs_events(load) and load.execution.policy == "open-loop"
    return load.execution.messages.instant and not by_clock and not is_driven(load.tpg)


class PathReplay:
    """Longest paths, all replications side by side: messages take no time."""

    eases_waits = True

    def __init__(self, load: Workload, numbers: Indices) -> None:
        engine = BulkEngine(load.tpg, load.execution)
        self.tpg = engine.contraction.tpg
        self.graph = until_work_is_done(self.tpg, engine.graph)
        times = engine.sample(seed=load.seed, replications=numbers)
        self.draws = Draws.completing(numbers, times)

    def base(self) -> Completions:
        """Return what came of the replications as they were drawn."""
        return completions(self.graph, self.draws.busy_ns)

    def makespans_ns(self, lever: Lever, share: float) -> Nanoseconds:
        """Return the makespans with a lever a share shorter, shape (r,) [ns]."""
        if len(lever.edges):
            return eased_makespans(self.graph, self.draws.busy_ns, lever.edges, share)
        with self.draws.less(lever, share) as busy_ns:
            return makespans(self.graph, busy_ns)


class DrivenReplay:
    """Robots that keep to limits of acceleration, node by node: messages take no time."""

    eases_waits = False

    def __init__(self, load: Workload, numbers: Indices) -> None:
        self._engine = engine = BulkEngine(load.tpg, load.execution)
        engine.graph = until_work_is_done(load.tpg, engine.graph)
        self.tpg, self.graph = load.tpg, engine.graph
        times = engine.sample(seed=load.seed, replications=numbers)
        self.draws = Draws.completing(numbers, times)

    def base(self) -> Completions:
        """Return what came of the replications as they were drawn."""
        return self._engine.execute(self.draws.times(self.draws.busy_ns))

    def makespans_ns(self, lever: Lever, share: float) -> Nanoseconds:
        """Return the makespans with a lever a share shorter, shape (r,) [ns]."""
        with self.draws.less(lever, share) as busy_ns:
            return self._engine.makespans(self.draws.times(busy_ns, lever, share))


def eased_makespans(
    graph: PrecedenceArrays, busy_ns: Nanoseconds, edges: Indices, share: float
) -> Nanoseconds:
    """Return makespans when what nodes wait for by some edges alone is a share shorter.

    Args:
        graph: what must wait for what.
        busy_ns: time of each node, shape (nodes, r) [ns].
        edges: whose waits are eased.
        share: 1 for robots that do not wait by these edges at all.

    Returns:
        Shape (r,) [ns].
    """
    eased = np.zeros(len(graph.source), dtype=bool)
    eased[edges] = True
    firsts, chains = graph.first.tolist(), graph.chain.tolist()
    sources, begins = graph.source.tolist(), graph.edge_first.tolist()
    end = np.empty_like(busy_ns)
    for n in graph.order.tolist():
        free = np.full(busy_ns.shape[1], graph.not_before[n], dtype=np.int64)
        if n > firsts[chains[n]]:
            np.maximum(free, end[n - 1], out=free)
        waits = []
        for e in range(begins[n], begins[n + 1]):
            if eased[e]:
                waits.append(end[sources[e]])
            else:
                np.maximum(free, end[sources[e]], out=free)
        if waits:
            free += shortened(np.maximum(np.max(waits, axis=0) - free, 0), share)
        end[n] = free + busy_ns[n]
    return makespans_of_ends(graph, end)


class MessageReplay:
    """Longest paths with messages that take time; nothing happens by the run's clock."""

    eases_waits = False

    def __init__(self, load: Workload, numbers: Indices) -> None:
        policy = load.execution.policy
        graph = policy_graph(load.tpg, policy)
        self.tpg, self.graph = load.tpg, until_work_is_done(load.tpg, graph)
        self.draws = _drawn(load, _node_by_node(load.tpg), numbers)
        own = load.execution.messages
        depth = 1 if policy == "sequential" else own.queue_depth
        # By the planned clock nobody talks to anybody.
        self._messages = (
            Messages() if policy == "open-loop" else own._replace(queue_depth=depth)
        )
        nodes, chains = len(self.graph.order), len(self.graph.first) - 1
        self._past = Past(
            0,
            np.full(nodes, -1, dtype=np.int64),
            np.full(nodes, -1, dtype=np.int64),
            np.zeros((chains, len(self.draws.numbers)), dtype=np.int64),
        )

    def base(self) -> Completions:
        """Return what came of the replications as they were drawn."""
        end = self._ends(self.draws.busy_ns, self._messages)
        return explain(self.graph, end - self.draws.busy_ns, end)

    def makespans_ns(self, lever: Lever, share: float) -> Nanoseconds:
        """Return the makespans with a lever a share shorter, shape (r,) [ns]."""
        messages = quicker(self._messages, share) if lever.messages else self._messages
        with self.draws.less(lever, share) as busy_ns:
            end = self._ends(busy_ns, messages)
        return makespans_of_ends(self.graph, end)

    def _ends(self, busy_ns: Nanoseconds, messages: Messages) -> Nanoseconds:
        return end_times(self.graph, busy_ns, messages, self._past)


class EventReplay:
    """The event engine, one replication after the other: stops by the run's clock."""

    eases_waits = False

    def __init__(self, load: Workload, numbers: Indices) -> None:
        self._model, self._seed = load.execution, load.seed
        policy = load.execution.policy
        self._driven = is_driven(load.tpg)
        cut = contract(load.tpg) if _in_segments(load) else _node_by_node(load.tpg)
        self.tpg = cut.tpg
        self.graph = until_work_is_done(cut.tpg, policy_graph(cut.tpg, policy))
        self.draws = _drawn(load, cut, numbers)
        barred = with_barriers(cut.tpg) if policy == "synchronous" else cut.tpg
        if policy == "sequential" and self._driven:
            barred = with_turns(barred)
        self._tpg, self._dispatcher = barred, Dispatcher(barred)
        self._planned = None
        if policy == "open-loop":
            self._planned = earliest_times(load.tpg, nominal_ns(load.tpg)).start

    def base(self) -> Completions:
        """Return what came of the replications as they were drawn."""
        runs = self._runs(self.draws.times(self.draws.busy_ns), self._model)
        return explain(self.graph, *(self._by_node(runs, k) for k in (0, 1)))

    def makespans_ns(self, lever: Lever, share: float) -> Nanoseconds:
        """Return the makespans with a lever a share shorter, shape (r,) [ns]."""
        model = self._model
        if lever.messages:
            model = replace(model, messages=quicker(model.messages, share))
        if lever.stops:
            fewer = _shorter_stops(model.disturbances, lever.stops, share)
            model = replace(model, disturbances=fewer)
        with self.draws.less(lever, share) as busy_ns:
            runs = self._runs(self.draws.times(busy_ns, lever, share), model)
        return makespans_of_ends(self.graph, self._by_node(runs, 1))

    def _by_node(
        self, runs: Sequence[tuple[list[list[int]], list[list[int]]]], which: int
    ) -> Nanoseconds:
        """Return starts (0) or ends (1) of every node, shape (nodes, replications) [ns]."""
        times = np.array([np.concatenate(run[which]) for run in runs], dtype=np.int64)
        return times.reshape(len(runs), -1).T

    def _runs(
        self, times: SegmentTimes, model: ExecutionModel
    ) -> list[tuple[list[list[int]], list[list[int]]]]:
        """Return start and end of every node in each replication."""
        cuts = self.graph.first[1:-1]
        stood_ns = times.stood_ns()
        runs = []
        for column, number in enumerate(self.draws.numbers.tolist()):
            stall = np.split(stood_ns[:, column], cuts)
            motion = np.split((times.busy_ns - stood_ns)[:, column], cuts)
            halts = sample_halts(
                self._tpg, model.disturbances, seed=self._seed, replication=number
            )
            drawn = NodeTimes(
                tuple(motion),
                tuple(stall),
                tuple(_standing(own) for own in stall),
                (-1,) * len(stall),
                halts,
            )
            execution = self._execution(drawn, model)
            execution.execute()
            runs.append((execution.start, execution.end))
        return runs

    def _execution(self, times: NodeTimes, model: ExecutionModel) -> Execution:
        dispatcher, messages = self._dispatcher.copy(), model.messages
        if self._driven:
            return DrivenExecution(
                self._tpg, times, dispatcher, messages, planned=self._planned
            )
        return Execution(
            self._tpg,
            times,
            dispatcher,
            messages,
            sequential=model.policy == "sequential",
            planned=self._planned,
        )


def _standing(stall: Nanoseconds) -> tuple[Standstill, ...]:
    """Return the standstills of the nodes of a robot."""
    return tuple(
        Standstill(node, "stall", int(stall[node]))
        for node in np.flatnonzero(stall).tolist()
    )


def quicker(messages: Messages, share: float) -> Messages:
    """Return messages that take a share less time."""
    report, release = shortened(
        np.array([messages.report_ns, messages.release_ns]), share
    ).tolist()
    return messages._replace(report_ns=report, release_ns=release)


def _shorter_stops(own: Disturbances, which: str, share: float) -> Disturbances:
    """Return disturbances whose stops by the clock last a share less."""
    if which == "breakdowns" and own.breakdowns is not None:
        mttr_s = (1.0 - share) * own.breakdowns.mttr_s
        shorter = own.breakdowns.model_copy(update={"mttr_s": mttr_s})
        return own.model_copy(update={"breakdowns": shorter})
    stops = tuple(
        stop.model_copy(update={"duration_s": (1.0 - share) * stop.duration_s})
        for stop in own.emergency_stops
        if share < 1.0
    )
    return own.model_copy(update={"emergency_stops": stops})


def _node_by_node(tpg: TemporalPlanGraph) -> Contraction:
    """Return a contraction that joins nothing."""
    return Contraction(tpg, tuple(np.arange(len(c) + 1) for c in tpg.chains))


def _drawn(load: Workload, cut: Contraction, numbers: Indices) -> Draws:
    model = load.execution
    free = at_full_speed(load.tpg)
    sampler = NodeTimeSampler(free, model.durations, model.disturbances)
    times = sampler.sample_segments(cut, seed=load.seed, replications=numbers)
    return Draws.completing(numbers, times)
