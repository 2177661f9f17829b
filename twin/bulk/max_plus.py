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

from planning.kernels import inner_kernel, kernel
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


class CompletionSums(NamedTuple):
    """Times of replications as in ``Completions``, and sums over them of what else is there.

    Attributes:
        critical: in how many replications each group of nodes has one on the critical path, shape (groups,).
        critical_edge: the same for edges, shape (edges,).
        slack_ns: sum of the least slacks of each group, shape (groups,) [ns].
    """

    start_ns: Nanoseconds
    end_ns: Nanoseconds
    chain_end_ns: Nanoseconds
    waited_ns: Nanoseconds
    critical: Indices
    critical_edge: Indices
    slack_ns: Nanoseconds


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
    start, end, chain_end, waited = _timed(graph, start_ns, end_ns)
    critical = np.zeros(end.shape, dtype=np.bool_)
    critical_edge = np.zeros((len(end), len(graph.source)), dtype=np.bool_)
    latest = np.empty_like(end)
    _explain(graph, start, end, chain_end, waited, critical, critical_edge, latest)
    times = start.T, end.T, chain_end.T, np.moveaxis(waited, 0, -1)
    return Completions(*times, critical.T, critical_edge.T, (latest - end).T)


def sum_completions(
    graph: PrecedenceArrays,
    groups: Indices,
    start_ns: Nanoseconds,
    end_ns: Nanoseconds,
) -> CompletionSums:
    """Return sums over replications; see ``explain_completions``.

    Args:
        graph: precedence graph.
        groups: first node of each group of consecutive nodes, shape (groups,).
        start_ns, end_ns: of every node, shape (nodes, replications) [ns].
    """
    start, end, chain_end, waited = _timed(graph, start_ns, end_ns)
    critical, slack = np.zeros_like(groups), np.zeros_like(groups)
    edges, borders = np.zeros_like(graph.source), np.append(groups, end.shape[1])
    _sum(graph, borders, start, end, chain_end, waited, critical, edges, slack)
    times = start.T, end.T, chain_end.T, np.moveaxis(waited, 0, -1)
    return CompletionSums(*times, critical, edges, slack)


def _timed(
    graph: PrecedenceArrays, start_ns: Nanoseconds, end_ns: Nanoseconds
) -> tuple[Nanoseconds, Nanoseconds, Nanoseconds, Nanoseconds]:
    """Return starts and ends of nodes and ends of chains, a replication's next to each other, and room for waits."""
    last = _last_ends(graph, end_ns)
    start, end, chain_end = (
        np.ascontiguousarray(own.T, dtype=np.int64) for own in (start_ns, end_ns, last)
    )
    return start, end, chain_end, np.zeros((*chain_end.shape, 3), dtype=np.int64)


@kernel
def _explain(
    graph: PrecedenceArrays,
    start: Nanoseconds,
    end: Nanoseconds,
    chain_end: Nanoseconds,
    waited: Nanoseconds,
    critical: npt.NDArray[np.bool_],
    critical_edge: npt.NDArray[np.bool_],
    latest: Nanoseconds,
) -> None:
    """Write waits, critical paths and latest ends, replication by replication.

    Latest ends are those of a backward pass from the makespan. The time of a node counts from the completion of its
    predecessors: messages in transit and turns leave no slack.
    """
    # In a loop numba would count references to arrays of a tuple.
    first, chain, last, order = graph.first, graph.chain, graph.last, graph.order
    edge_first, source, cause = graph.edge_first, graph.source, graph.cause
    not_before = graph.not_before
    for r in range(len(end)):
        done = end[r]
        n, makespan = -1, np.int64(-1)
        for k in range(len(last)):
            since = np.int64(0)
            for m in range(first[k], first[k + 1]):
                if start[r, m] > since:
                    edge, met = _latest_source(edge_first, source, cause, done, m)
                    if edge >= 0 and met > since:
                        until = min(met, start[r, m])
                        waited[r, k, int(cause[edge])] += until - since
                        since = until
                    waited[r, k, OTHER] += start[r, m] - since
                since = done[m]
            if last[k] >= 0 and chain_end[r, k] > makespan:
                n, makespan = last[k], chain_end[r, k]
        while n >= 0:
            critical[r, n] = True
            own = n - 1 if n > first[chain[n]] else -1
            since = done[own] if own >= 0 else np.int64(0)
            edge, met = _latest_source(edge_first, source, cause, done, n)
            if not_before[n] > max(since, met):
                break  # started by the clock, not by another node
            if edge >= 0 and met > since:
                critical_edge[r, edge] = True
                own = source[edge]
            n = own
        for n in range(len(done)):
            latest[r, n] = max(makespan, done[n])
        for k in range(len(order) - 1, -1, -1):
            n = order[k]
            own = n - 1 if n > first[chain[n]] else -1
            since = not_before[n]
            if own >= 0:
                since = max(since, done[own])
            for e in range(edge_first[n], edge_first[n + 1]):
                since = max(since, done[source[e]])
            begin = latest[r, n] - (done[n] - since)
            if own >= 0:
                latest[r, own] = min(latest[r, own], begin)
            for e in range(edge_first[n], edge_first[n + 1]):
                latest[r, source[e]] = min(latest[r, source[e]], begin)


@inner_kernel
def _latest_source(
    edge_first: Indices,
    source: Indices,
    cause: npt.NDArray[np.uint8],
    done: Nanoseconds,
    n: int,
) -> tuple[int, np.int64]:
    """Return the edge whose source was complete last, and its time; -1 and 0 without edges."""
    found, latest, why = -1, np.int64(0), OTHER
    for e in range(edge_first[n], edge_first[n + 1]):
        met = done[source[e]]
        if found < 0 or met > latest or (met == latest and int(cause[e]) < why):
            found, latest, why = e, met, int(cause[e])
    return found, latest


@kernel
def _sum(
    graph: PrecedenceArrays,
    borders: Indices,
    start: Nanoseconds,
    end: Nanoseconds,
    chain_end: Nanoseconds,
    waited: Nanoseconds,
    critical: Indices,
    critical_edge: Indices,
    slack: Nanoseconds,
) -> None:
    """Write waits, and add up what else is explained of each replication."""
    path = np.empty((1, end.shape[1]), np.bool_)
    edges = np.empty((1, len(critical_edge)), np.bool_)
    latest = np.empty((1, end.shape[1]), np.int64)
    for r in range(len(end)):
        path[:], edges[:] = False, False
        own = slice(r, r + 1)
        begun, done, last = start[own], end[own], chain_end[own]
        _explain(graph, begun, done, last, waited[own], path, edges, latest)
        for g in range(len(critical)):
            least, found = np.int64(EVER), False
            for n in range(borders[g], borders[g + 1]):
                least = min(least, latest[0, n] - end[r, n])
                found = found or path[0, n]
            slack[g] += least
            critical[g] += found
        for e in range(len(critical_edge)):
            critical_edge[e] += edges[0, e]


def _last_ends(graph: PrecedenceArrays, end: Nanoseconds) -> Nanoseconds:
    """Return the end of each chain, 0 for an empty one."""
    out = np.zeros((len(graph.last), end.shape[1]), dtype=np.int64)
    done = graph.last >= 0
    out[done] = end[graph.last[done]]
    return out
