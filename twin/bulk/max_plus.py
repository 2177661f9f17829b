"""Completion times and critical paths of many replications, computed as longest paths (max-plus algebra).

The precedence graph of each policy is stored as flat arrays for compiled code. If every node starts as soon as its
predecessors are complete, its end is the latest end of its predecessors plus its duration. One pass over the nodes
in topological order computes the ends in all replications, with the same integer nanoseconds as the event engine.

Message latencies and action queues of limited length also give maxima of sums. If the queue of a robot holds at most
d nodes, the dispatcher releases node n once node n - d and all predecessors of n are reported complete::

    released(n) = max(released(n - 1), end(n - d) + report, end(source) + report, ...)
    start(n)    = max(end(n - 1), released(n) + release)

For a run in progress, known times can be given, and the others are computed from them. Causes of waits and critical
paths are derived from the node times of either engine.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from planning.kernels import kernel
from planning.transforms import Indices
from scheduling.graph.rollout import earliest_times
from scheduling.graph.task_edges import sequential_order, turn_edges
from scheduling.graph.temporal_plan_graph import EVER, NO_EDGES, TemporalPlanGraph
from scheduling.graph.total_order import flatten_graph, planned_ranks
from scheduling.graph.windows import followed_order
from twin.durations.nanoseconds import Nanoseconds
from twin.engine.dispatch_policies import with_policy
from twin.engine.execution_model import OTHER, Messages
from twin.runs.execution_record import Policy
from twin.uncertainty.skill_durations import nominal_ns

_BLOCK = 64
"""Replications computed together: their ends of all nodes of a cell stay in the cache."""

AT_ONCE = Messages()
"""Messages that take no time."""


class PrecedenceArrays(NamedTuple):
    """A flat graph with the causes of its edges and earliest starts.

    Attributes:
        first, chain, order, edge_first, source: see FlatGraph.
        cause: why, by edge, shape (edges,).
        not_before: no node starts before this, shape (nodes,) [ns].
        last: last node of each chain, -1 for none, shape (chains,).
        patience: how long after the begin of its source each edge holds at most, shape (edges,) [ns]; empty
            where every edge holds until its source is complete.
    """

    first: Indices
    chain: Indices
    order: Indices
    edge_first: Indices
    source: Indices
    cause: npt.NDArray[np.uint8]
    not_before: Nanoseconds
    last: Indices
    patience: Nanoseconds


def policy_graph(tpg: TemporalPlanGraph, policy: Policy) -> PrecedenceArrays:
    """Return the predecessors of every node of a plan under a policy.

    Args:
        tpg: the plan.
        policy: ``"asynchronous"`` waits by the edges of the plan, ``"synchronous"`` for
            everyone at the end of each slot as well; ``"sequential"`` is one chain of all
            nodes of robots, while machines run in parallel; under ``"open-loop"`` a node waits for its
            planned time and nothing else. The waits of registered policies are edges of the plan already, see
            ``with_model_holds``.

    Raises:
        PlanInvariantError: the policy is synchronous, but the plan was not made in slots.
    """
    if policy == "synchronous":
        barred = with_policy(tpg, policy, OTHER)
        # Barriers need not follow the planned starts, as edges do.
        return precedence_arrays(barred)._replace(order=_sequential_order(barred))
    if policy == "sequential":
        return _in_turns(tpg)
    if policy == "open-loop":
        free = replace(tpg, edges=NO_EDGES[0], cause=NO_EDGES[1])
        starts = earliest_times(tpg, nominal_ns(tpg)).start
        return precedence_arrays(free, np.concatenate(starts))
    return precedence_arrays(tpg)


def precedence_arrays(
    tpg: TemporalPlanGraph, not_before_ns: Nanoseconds | None = None
) -> PrecedenceArrays:
    """Return the precedence arrays of a TPG, contracted or not.

    Args:
        tpg: the graph.
        not_before_ns: no node starts before this, shape (nodes,) [ns]; 0 by default.
    """
    # A task held back may depend on one planned later.
    flat = followed_order(flatten_graph(planned_ranks(tpg.chains), tpg.edges), tpg)
    return PrecedenceArrays(
        flat.first,
        flat.chain,
        flat.order,
        flat.edge_first,
        flat.source,
        tpg.cause[flat.row],
        np.zeros_like(flat.order) if not_before_ns is None else not_before_ns,
        np.where(np.diff(flat.first) > 0, flat.first[1:] - 1, -1),
        tpg.patience[flat.row] if len(tpg.patience) else tpg.patience,
    )


def _in_turns(tpg: TemporalPlanGraph) -> PrecedenceArrays:
    """Return one chain of all nodes of robots, in the planned sequence of tasks.

    Machines are not in the sequence: their dependencies stay as planned.
    """
    kept = np.isin(tpg.edges[:, [0, 2]], list(tpg.machine_chains())).any(axis=1)
    turns = turn_edges(tpg)
    other = np.full(len(turns), OTHER, dtype=np.uint8)
    edges = np.concatenate([tpg.edges[kept], turns])
    cause = np.concatenate([tpg.cause[kept], other])
    graph = precedence_arrays(replace(tpg, edges=edges, cause=cause))
    return graph._replace(order=_sequential_order(tpg))


def _sequential_order(tpg: TemporalPlanGraph) -> Indices:
    return np.fromiter(sequential_order(tpg), dtype=np.int64)


@dataclass(frozen=True)
class Completions:
    """Node times, waits and critical paths of replications.

    Attributes:
        start_ns, end_ns: of every node, shape (nodes, replications) [ns].
        chain_end_ns: when each chain is done, shape (chains, replications) [ns].
        waited_ns: waiting time of each robot, shape (chains, 3, replications) [ns], by
            TASK_DEPENDENCY, MOTION_CONFLICT and OTHER: the time until the last of the nodes
            waited for was complete is its edge's, a dependency's on a tie, and what is left is
            OTHER.
        critical: True where a node is on a critical path, shape (nodes, replications); there is
            one path a replication, and a robot's own predecessor comes before another robot's.
        critical_edge: the same for edges, shape (edges, replications).
        slack_ns: by how much a node could end later without a later end of the run if all else
            took as long as it did, shape (nodes, replications) [ns].
    """

    start_ns: Nanoseconds
    end_ns: Nanoseconds
    chain_end_ns: Nanoseconds
    waited_ns: Nanoseconds
    critical: npt.NDArray[np.bool_]
    critical_edge: npt.NDArray[np.bool_]
    slack_ns: Nanoseconds

    @property
    def makespan_ns(self) -> Nanoseconds:
        """Makespan of every replication, shape (replications,) [ns]."""
        return np.asarray(self.chain_end_ns.max(axis=0, initial=0), dtype=np.int64)


def makespans(graph: PrecedenceArrays, end_ns: Nanoseconds) -> Nanoseconds:
    """Return the makespan of every replication from the ends of all nodes, shape (replications,) [ns]."""
    ends = _last_ends(graph, end_ns)
    return np.asarray(ends.max(axis=0, initial=0), dtype=np.int64)


class Past(NamedTuple):
    """State of a run in progress, by node; nodes are numbered through, chain by chain.

    Attributes:
        now_ns: the current time; later nodes start no earlier [ns].
        start_ns: -1 for a node that has not started, shape (nodes,) [ns].
        end_ns: -1 for a node that is not complete, shape (nodes,) [ns].
        not_before_ns: earliest continuation of each robot, shape (chains, replications) [ns].
    """

    now_ns: int
    start_ns: Nanoseconds
    end_ns: Nanoseconds
    not_before_ns: Nanoseconds


def end_times(
    graph: PrecedenceArrays,
    busy_ns: Nanoseconds,
    messages: Messages = AT_ONCE,
    past: Past | None = None,
) -> Nanoseconds:
    """Return the completion time of every node in every replication.

    Args:
        graph: precedence graph; contracted only if messages take no time.
        busy_ns: standstills and duration of each node together, for a node under way what is left
            of it from now on, shape (nodes, replications) [ns].
        messages: between robots and dispatcher.
        past: the past of a run, None without one.

    Returns:
        Shape (nodes, replications) [ns].
    """
    busy = np.ascontiguousarray(busy_ns, dtype=np.int64)
    if past is None:
        if messages.instant:
            return _end_times(graph, busy)
        never = np.full(len(graph.order), -1, dtype=np.int64)
        free = np.zeros((len(graph.last), busy.shape[1]), dtype=np.int64)
        past = Past(0, never, never, free)
    ahead = messages.ahead(driven=False)
    return _message_end_times(graph, busy, messages._replace(queue_depth=ahead), past)


def completions(
    graph: PrecedenceArrays, busy_ns: Nanoseconds, messages: Messages = AT_ONCE
) -> Completions:
    """Return node times, waits and critical paths of every replication; see ``end_times``."""
    end = end_times(graph, busy_ns, messages)
    return explain_completions(graph, end - busy_ns, end)


@kernel
def _end_times(graph: PrecedenceArrays, busy: Nanoseconds) -> Nanoseconds:
    end = np.empty_like(busy)
    patient = len(graph.patience) > 0
    for low in range(0, busy.shape[1], _BLOCK):
        high = min(low + _BLOCK, busy.shape[1])
        for n in graph.order:
            own = n - 1 if n > graph.first[graph.chain[n]] else -1
            for r in range(low, high):
                end[n, r] = graph.not_before[n]
            if own >= 0:
                for r in range(low, high):
                    end[n, r] = max(end[n, r], end[own, r])
            for e in range(graph.edge_first[n], graph.edge_first[n + 1]):
                source = graph.source[e]
                if patient and graph.patience[e] < EVER:
                    for r in range(low, high):
                        lifted = end[source, r] - busy[source, r] + graph.patience[e]
                        end[n, r] = max(end[n, r], min(end[source, r], lifted))
                    continue
                for r in range(low, high):
                    end[n, r] = max(end[n, r], end[source, r])
            for r in range(low, high):
                end[n, r] += busy[n, r]
    return end


@kernel
def _message_end_times(
    graph: PrecedenceArrays, busy_ns: Nanoseconds, messages: Messages, past: Past
) -> Nanoseconds:
    end, released = np.empty_like(busy_ns), np.empty_like(busy_ns)
    now = np.int64(past.now_ns)
    for n in graph.order:
        chain = graph.chain[n]
        own = n - 1 if n > graph.first[chain] else -1
        ahead = n - messages.queue_depth
        known_start, known_end = past.start_ns[n], past.end_ns[n]
        for r in range(busy_ns.shape[1]):
            if known_start >= 0:
                released[n, r] = known_start - messages.release_ns
                if known_end >= 0:
                    end[n, r] = known_end
                else:
                    end[n, r] = max(now, past.not_before_ns[chain, r])
                    end[n, r] += busy_ns[n, r]
                continue
            t = np.int64(0)
            if own >= 0:
                t = released[own, r]
            if ahead >= graph.first[chain]:
                t = max(t, end[ahead, r] + messages.report_ns)
            for e in range(graph.edge_first[n], graph.edge_first[n + 1]):
                source = graph.source[e]
                met = end[source, r]
                if len(graph.patience) > 0 and graph.patience[e] < EVER:
                    begun = past.start_ns[source]
                    if begun < 0:
                        begun = met - busy_ns[source, r]
                    met = min(met, begun + graph.patience[e])
                t = max(t, met + messages.report_ns)
            released[n, r] = t
            t += messages.release_ns
            if own >= 0:
                t = max(t, end[own, r])
            t = max(t, now)
            t = max(t, graph.not_before[n])
            t = max(t, past.not_before_ns[chain, r])
            end[n, r] = t + busy_ns[n, r]
    return end


@kernel
def _lower(graph: PrecedenceArrays, end: Nanoseconds, latest: Nanoseconds) -> None:
    """Compute the latest ends of nodes in a backward pass from the makespan.

    The time of a node counts from the completion of its predecessors: messages in transit and turns
        leave no slack.
    """
    for k in range(len(graph.order) - 1, -1, -1):
        n = graph.order[k]
        own = n - 1 if n > graph.first[graph.chain[n]] else -1
        for r in range(end.shape[1]):
            since = graph.not_before[n]
            if own >= 0:
                since = max(since, end[own, r])
            for e in range(graph.edge_first[n], graph.edge_first[n + 1]):
                since = max(since, end[graph.source[e], r])
            begin = latest[n, r] - (end[n, r] - since)
            if own >= 0:
                latest[own, r] = min(latest[own, r], begin)
            for e in range(graph.edge_first[n], graph.edge_first[n + 1]):
                source = graph.source[e]
                latest[source, r] = min(latest[source, r], begin)


def explain_completions(
    graph: PrecedenceArrays,
    start_ns: Nanoseconds,
    end_ns: Nanoseconds,
) -> Completions:
    """Return waiting times by cause, slack, and the critical path of each replication.

    Args:
        graph: precedence graph.
        start_ns, end_ns: of every node, shape (nodes, replications) [ns].
    """
    start = np.ascontiguousarray(start_ns, dtype=np.int64)
    end = np.ascontiguousarray(end_ns, dtype=np.int64)
    chain_end = _last_ends(graph, end)
    waited = _waits(graph, start, end)
    critical, critical_edge = _critical_paths(graph, end, chain_end)
    latest = np.maximum(chain_end.max(axis=0, initial=0), end)
    _lower(graph, end, latest)
    slack = latest - end
    return Completions(start, end, chain_end, waited, critical, critical_edge, slack)


@kernel
def _latest_source(
    graph: PrecedenceArrays, end: Nanoseconds, n: int, r: int
) -> tuple[int, int]:
    """Return the edge whose source was complete last, and its time; -1 and 0 without edges."""
    found, latest, cause = -1, 0, OTHER
    for e in range(graph.edge_first[n], graph.edge_first[n + 1]):
        done = end[graph.source[e], r]
        if (
            found < 0
            or done > latest
            or (done == latest and int(graph.cause[e]) < cause)
        ):
            found, latest, cause = e, done, int(graph.cause[e])
    return found, latest


@kernel
def _waits(
    graph: PrecedenceArrays, start: Nanoseconds, end: Nanoseconds
) -> Nanoseconds:
    waited = np.zeros((len(graph.first) - 1, 3, start.shape[1]), np.int64)
    for n in range(len(graph.order)):
        chain = graph.chain[n]
        own = n - 1 if n > graph.first[chain] else -1
        for r in range(start.shape[1]):
            since = end[own, r] if own >= 0 else 0
            if start[n, r] <= since:
                continue
            edge, done = _latest_source(graph, end, n, r)
            if edge >= 0 and done > since:
                until = min(done, start[n, r])
                waited[chain, int(graph.cause[edge]), r] += until - since
                since = until
            waited[chain, OTHER, r] += start[n, r] - since
    return waited


@kernel
def _critical_paths(
    graph: PrecedenceArrays, end: Nanoseconds, last_end: Nanoseconds
) -> tuple[npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
    """Mark one critical path per replication, from the end back to the start of the run."""
    critical = np.zeros(end.shape, np.bool_)
    critical_edge = np.zeros((len(graph.source), end.shape[1]), np.bool_)
    for r in range(end.shape[1]):
        n, latest = -1, -1
        for chain in range(len(graph.first) - 1):
            last = graph.last[chain]
            if last >= 0 and last_end[chain, r] > latest:
                n, latest = last, last_end[chain, r]
        while n >= 0:
            critical[n, r] = True
            own = n - 1 if n > graph.first[graph.chain[n]] else -1
            since = end[own, r] if own >= 0 else 0
            edge, done = _latest_source(graph, end, n, r)
            if graph.not_before[n] > max(since, done):
                break  # started by the clock, not by another node
            if edge >= 0 and done > since:
                critical_edge[edge, r] = True
                n = graph.source[edge]
            else:
                n = own
    return critical, critical_edge


def _last_ends(graph: PrecedenceArrays, end: Nanoseconds) -> Nanoseconds:
    """Return the end of each chain, 0 for an empty one."""
    out = np.zeros((len(graph.last), end.shape[1]), dtype=np.int64)
    done = graph.last >= 0
    out[done] = end[graph.last[done]]
    return out
