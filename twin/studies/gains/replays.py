"""Interventions, each of which shortens a part of a plan, and their simulation.

The replications of a study are simulated again with the same random draws.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np

from planning.tasks.task import TaskKind
from planning.transforms import Indices
from scheduling.graph.temporal_plan_graph import EVER, TemporalPlanGraph
from scheduling.motion_times import is_driven, with_full_speed_times
from twin.bulk.bulk_engine import BulkEngine, contract_for_bulk
from twin.bulk.max_plus import (
    Completions,
    PrecedenceArrays,
    explain_completions,
    makespans,
    policy_graph,
)
from twin.durations.nanoseconds import Nanoseconds
from twin.engine.engine import Simulator
from twin.engine.execution_model import ExecutionModel, Messages
from twin.studies.replications.workload import Workload
from twin.uncertainty.chain_draws import Cause
from twin.uncertainty.contraction import Contraction
from twin.uncertainty.disturbances import Disturbances
from twin.uncertainty.node_times import (
    NodeTimes,
    NodeTimeSampler,
    SegmentTimes,
    Standstill,
)
from twin.uncertainty.stop_times import draw_stops

Kind = Literal["task", "skill", "robot", "wait", "stall", "message"]


def _none() -> Indices:
    return np.empty(0, dtype=np.int64)


@dataclass(frozen=True)
class Intervention:
    """Part of a plan whose time could be reduced.

    Attributes:
        kind: a task, all tasks of a kind, all work of a robot, waits of one task for another or all waits of a
            cause, standstills, or messages.
        name: name for people.
        robot: its robot, empty without one.
        task: index of the task; for a wait, of the task that waits; None where there is none.
        rows: shortened nodes, numbered chain by chain.
        causes: causes of the standstills of these nodes that are shortened; empty where their work is.
        edges: indices of the edges whose waits are shortened.
        stops: shortened stops at times of the run's clock, empty for none.
        messages: True where the delays of messages between robots and dispatcher are shortened.
    """

    kind: Kind
    name: str
    robot: str = ""
    task: int | None = None
    rows: Indices = field(default_factory=_none)
    causes: tuple[Cause, ...] = ()
    edges: Indices = field(default_factory=_none)
    stops: Literal["", "breakdowns", "emergency stops"] = ""
    messages: bool = False

    @property
    def many(self) -> bool:
        """True for a joint intervention, not of a single task, wait or robot's standstills."""
        if self.kind in ("task", "wait"):
            return self.task is None
        return self.kind != "stall" or not self.robot


def needs_event_engine(load: Workload) -> bool:
    """Return whether replays need the event engine."""
    model = load.execution
    return load.by_events and (
        is_driven(load.tpg)
        or model.disturbances.at_absolute_times
        or model.policy == "synchronous"
    )


def replay_cost(load: Workload) -> int:
    """Return the number of nodes and edges processed per replication."""
    tpg = load.tpg
    if not (needs_event_engine(load) and load.execution.policy == "open-loop"):
        tpg = contract_for_bulk(tpg, load.execution).tpg
    return sum(len(chain) for chain in tpg.chains) + len(tpg.edges)


class Replay:
    """Replications of one workload that can be replayed with an intervention.

    The bulk engine replays them where it can, else the event engine, one replication after the other.
    Replications in which a task fails for good are left out.

    Attributes:
        tpg: plan to execute, contracted where that changes nothing.
        graph: precedence graph, until all work is done.
        numbers: numbers of the replications, shape (r,).
        times: node times of the replications.
        eases_waits: whether waits can be shortened.
    """

    def __init__(
        self, load: Workload, numbers: Indices, *, by_events: bool | None = None
    ) -> None:
        """Draw the replications.

        Args:
            load: the work of one cell.
            numbers: of the replications.
            by_events: whether the event engine executes them; None to choose.
        """
        model = self._model = load.execution
        self._seed = load.seed
        self._bulk: BulkEngine | None = None
        self._simulator: Simulator | None = None
        if needs_event_engine(load) if by_events is None else by_events:
            self._simulator = Simulator(load.tpg, model)
            cut = Contraction.trivial(load.tpg)
            if self._simulator.contraction is not None:
                cut = contract_for_bulk(load.tpg, model)
            free = with_full_speed_times(load.tpg)
            sampler = NodeTimeSampler(free, model.durations, model.disturbances)
            times = sampler.sample_segments(cut, seed=load.seed, replications=numbers)
            graph = graph_until_work_ends(cut.tpg, policy_graph(cut.tpg, model.policy))
        else:
            self._bulk = BulkEngine(load.tpg, model, by_node=True)
            cut = self._bulk.contraction
            times = self._bulk.sample(seed=load.seed, replications=numbers)
            graph = graph_until_work_ends(cut.tpg, self._bulk.graph)
            self._bulk.graph = graph
        self.tpg, self.graph = cut.tpg, graph
        self.numbers, self.times = numbers[~times.fails], times.completing()
        waits = load.by_events or self._simulator or is_driven(load.tpg)
        self.eases_waits = not waits

    @cached_property
    def work_ns(self) -> Nanoseconds:
        """Times of nodes without standstills, shape (nodes, r) [ns]."""
        return np.asarray(self.times.busy_ns - self.times.stood_ns())

    def base(self) -> Completions:
        """Return the results of the replications without an intervention."""
        if self._bulk is not None:
            return self._bulk.execute(self.times)
        return explain_completions(
            self.graph, *self._by_events(self.times, self._model)
        )

    def makespans_ns(self, intervention: Intervention, share: float) -> Nanoseconds:
        """Return makespans with an intervention shortened by a share, shape (r,) [ns]."""
        if len(intervention.edges):
            busy_ns = self.times.busy_ns
            return makespans_with_eased_waits(
                self.graph, busy_ns, intervention.edges, share
            )
        model = self._model
        if intervention.messages:
            model = replace(model, messages=speed_up_messages(model.messages, share))
        if intervention.stops:
            fewer = _shorter_stops(model.disturbances, intervention.stops, share)
            model = replace(model, disturbances=fewer)
        with self._shortened(intervention, share) as times:
            if self._bulk is not None:
                said = model.messages.under(model.policy)
                return self._bulk.makespans(times, said)
            return makespans(self.graph, self._by_events(times, model)[1])

    @contextmanager
    def _shortened(
        self, intervention: Intervention, share: float
    ) -> Iterator[SegmentTimes]:
        """Yield node times with an intervention shortened by a share.

        Each node is shortened separately. An intervention on standstills leaves the work as drawn, any other
        leaves the standstills as drawn. The array of ``times`` is changed in place and restored afterwards:
        copying it would take longer than the replay.
        """
        busy_ns, rows = self.times.busy_ns, intervention.rows
        kept, groups = busy_ns[rows], list(self.times.standstills)
        if intervention.causes:
            for k, group in enumerate(groups):
                if group.cause in intervention.causes:
                    own = np.isin(group.node, rows)
                    less = shorten_times(group.duration_ns, share)
                    less = np.where(own, less, group.duration_ns)
                    gone = group.duration_ns - less
                    np.subtract.at(busy_ns, (group.node, group.column), gone)
                    groups[k] = replace(group, duration_ns=less)
        elif len(rows):
            work = self.work_ns[rows]
            busy_ns[rows] = kept - work + shorten_times(work, share)
        try:
            yield replace(self.times, standstills=tuple(groups))
        finally:
            busy_ns[rows] = kept

    def _by_events(
        self, times: SegmentTimes, model: ExecutionModel
    ) -> tuple[Nanoseconds, Nanoseconds]:
        """Return start and end of every node, shape (nodes, replications) [ns]."""
        assert self._simulator is not None
        cuts = self.graph.first[1:-1]
        stood_ns = times.stood_ns()
        start, end = np.empty_like(stood_ns), np.empty_like(stood_ns)
        for column, number in enumerate(self.numbers.tolist()):
            stood = np.split(stood_ns[:, column], cuts)
            override = times.speed_override[:, column : column + 1].ravel()
            drawn = NodeTimes(
                tuple(np.split((times.busy_ns - stood_ns)[:, column], cuts)),
                tuple(stood),
                tuple(
                    tuple(
                        Standstill(node, "stall", int(own[node]))
                        for node in np.flatnonzero(own).tolist()
                    )
                    for own in stood
                ),
                (-1,) * len(stood),
                draw_stops(
                    self.tpg, model.disturbances, seed=self._seed, replication=number
                ),
                speed_override=tuple(np.split(override, cuts)) if len(override) else (),
            )
            done = self._simulator.execute(drawn, model.messages)
            start[:, column] = np.concatenate(done.start)
            end[:, column] = np.concatenate(done.end)
        return start, end


def graph_until_work_ends(
    tpg: TemporalPlanGraph, graph: PrecedenceArrays
) -> PrecedenceArrays:
    """Return the graph of runs that end when all work is done.

    Work is all but transits on which nothing depends: a robot that goes HOME after its last skill has
    done its part. In a plan without skills, all is work.
    """
    works = np.array([task.kind != TaskKind.TRANSIT or task.goal for task in tpg.tasks])
    last = np.full(len(tpg.chains), -1, dtype=np.int64)
    for k, chain in enumerate(tpg.chains):
        own = np.flatnonzero(works[chain.task])
        if len(own):
            last[k] = graph.first[k] + own[-1]
    return graph._replace(last=last) if np.any(last >= 0) else graph


def makespans_with_eased_waits(
    graph: PrecedenceArrays, busy_ns: Nanoseconds, edges: Indices, share: float
) -> Nanoseconds:
    """Return makespans when the waits along some edges are shortened by a share.

    Args:
        graph: precedence graph.
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
    patience = graph.patience.tolist()
    end = np.empty_like(busy_ns)
    for n in graph.order.tolist():
        free = np.full(busy_ns.shape[1], graph.not_before[n], dtype=np.int64)
        if n > firsts[chains[n]]:
            np.maximum(free, end[n - 1], out=free)
        waits = []
        for e in range(begins[n], begins[n + 1]):
            met = end[sources[e]]
            if patience and patience[e] < EVER:
                lifted = met - busy_ns[sources[e]] + patience[e]
                met = np.minimum(met, lifted)
            if eased[e]:
                waits.append(met)
            else:
                np.maximum(free, met, out=free)
        if waits:
            free += shorten_times(np.maximum(np.max(waits, axis=0) - free, 0), share)
        end[n] = free + busy_ns[n]
    return makespans(graph, end)


def shorten_times(times_ns: Nanoseconds, share: float) -> Nanoseconds:
    """Return times reduced by a share, in whole nanoseconds."""
    return np.asarray(np.rint((1.0 - share) * times_ns), dtype=np.int64)


def speed_up_messages(messages: Messages, share: float) -> Messages:
    """Return messages with latencies reduced by a share."""
    report, release = shorten_times(
        np.array([messages.report_ns, messages.release_ns]), share
    ).tolist()
    return messages._replace(report_ns=report, release_ns=release)


def _shorter_stops(own: Disturbances, which: str, share: float) -> Disturbances:
    """Return disturbances with stops shortened by a share."""
    if which == "breakdowns" and own.breakdowns is not None:
        return own.changed(breakdowns=own.breakdowns.repaired_faster(share))
    stops = tuple(
        stop.changed(duration_s=(1.0 - share) * stop.duration_s)
        for stop in own.emergency_stops
        if share < 1.0
    )
    return own.changed(emergency_stops=stops)
