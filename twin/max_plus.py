"""Completion times of many replications at once: longest paths in a max-plus algebra.

Where every node starts as soon as what it waits for is complete, its end is the greatest end of
its predecessors plus its own time. That needs no events: one pass over the nodes in a total
order, for all replications side by side, in the same integer nanoseconds as the event engine.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from scheduling.order import planned_ranks
from scheduling.temporal_plan_graph import Indices, TemporalPlanGraph
from twin.durations import Nanoseconds


class PrecedenceArrays(NamedTuple):
    """A TPG as flat arrays; nodes of all chains are numbered through, chain by chain.

    Attributes:
        order: node numbers in a total order that every edge follows, shape (nodes,).
        before: the node before it in its chain, -1 for a first node, shape (nodes,).
        edge_first: edges into node n are ``edge_first[n]`` to ``edge_first[n + 1]``,
            shape (nodes + 1,).
        source: the node that must be complete, by edge, shape (edges,).
        cause: why, by edge, shape (edges,).
        chain_first: first node of each chain and the number of nodes, shape (chains + 1,).
        not_before: no node starts before this, shape (nodes,) [ns].
    """

    order: Indices
    before: Indices
    edge_first: Indices
    source: Indices
    cause: npt.NDArray[np.uint8]
    chain_first: Indices
    not_before: Nanoseconds


@dataclass(frozen=True)
class Completions:
    """What came of replications that were computed side by side.

    Attributes:
        start_ns, end_ns: of every node, shape (nodes, replications) [ns].
        makespan_ns: shape (replications,) [ns].
        chain_end_ns: end of each robot's last node, shape (chains, replications) [ns].
        waited_ns: what each robot waited for by cause, shape (chains, 2, replications) [ns];
            TASK_DEPENDENCY and MOTION_CONFLICT are the indices.
        critical: True where a node is on a critical path, shape (nodes, replications).
        critical_edge: the same for edges, shape (edges, replications).
        slack_ns: by how much a node could end later without a later end of the run,
            shape (nodes, replications) [ns].
    """

    start_ns: Nanoseconds
    end_ns: Nanoseconds
    makespan_ns: Nanoseconds
    chain_end_ns: Nanoseconds
    waited_ns: Nanoseconds
    critical: npt.NDArray[np.bool_]
    critical_edge: npt.NDArray[np.bool_]
    slack_ns: Nanoseconds


def precedence_arrays(
    tpg: TemporalPlanGraph, not_before_ns: Nanoseconds | None = None
) -> PrecedenceArrays:
    """Return a TPG, contracted or not, as the flat arrays that the kernels take.

    Args:
        tpg: the graph; edge k of the arrays is row ``edge_order(tpg)[k]`` of its edges.
        not_before_ns: no node starts before this, shape (nodes,) [ns]; 0 by default.
    """
    ranks = planned_ranks(tpg.chains)
    first = np.cumsum([0, *(len(r) for r in ranks)]).astype(np.int64)
    total = int(first[-1])
    rank = np.concatenate([*ranks, np.empty(0, dtype=np.int64)])
    before = np.arange(-1, total - 1, dtype=np.int64)
    before[first[:-1][np.diff(first) > 0]] = -1
    by_target = edge_order(tpg)
    target = first[tpg.edges[:, 2]] + tpg.edges[:, 3]
    source = first[tpg.edges[:, 0]] + tpg.edges[:, 1]
    return PrecedenceArrays(
        order=np.argsort(rank).astype(np.int64),
        before=before,
        edge_first=np.searchsorted(target[by_target], np.arange(total + 1)).astype(
            np.int64
        ),
        source=np.ascontiguousarray(source[by_target], dtype=np.int64),
        cause=np.ascontiguousarray(tpg.cause[by_target]),
        chain_first=first,
        not_before=np.zeros(total, dtype=np.int64)
        if not_before_ns is None
        else np.ascontiguousarray(not_before_ns, dtype=np.int64),
    )


def edge_order(tpg: TemporalPlanGraph) -> Indices:
    """Return the rows of ``tpg.edges`` in the order of the edges of its PrecedenceArrays."""
    return np.lexsort((tpg.edges[:, 3], tpg.edges[:, 2])).astype(np.int64)


def makespans(graph: PrecedenceArrays, busy_ns: Nanoseconds) -> Nanoseconds:
    """Return the end of the run of every replication, and nothing else.

    Args:
        graph: what must wait for what.
        busy_ns: stall and duration of each node together, shape (nodes, replications) [ns].

    Returns:
        Shape (replications,) [ns].
    """
    busy = np.ascontiguousarray(busy_ns, dtype=np.int64)
    end = np.empty_like(busy)
    for first in range(0, busy.shape[1], _BLOCK):
        _ends(graph, busy, first, min(first + _BLOCK, busy.shape[1]), end)
    return np.asarray(_last(graph, end).max(axis=0, initial=0), dtype=np.int64)


def completions(graph: PrecedenceArrays, busy_ns: Nanoseconds) -> Completions:
    """Return when everything happens in every replication, and what decided it.

    Args:
        graph: what must wait for what.
        busy_ns: stall and duration of each node together, shape (nodes, replications) [ns].
    """
    busy = np.ascontiguousarray(busy_ns, dtype=np.int64)
    nodes, replications = busy.shape
    chains = len(graph.chain_first) - 1
    end = np.empty_like(busy)
    waited = np.zeros((chains, 2, replications), dtype=np.int64)
    critical = np.zeros((nodes, replications), dtype=np.bool_)
    critical_edge = np.zeros((len(graph.source), replications), dtype=np.bool_)
    latest = np.empty_like(busy)
    for first in range(0, replications, _BLOCK):
        _ends(graph, busy, first, min(first + _BLOCK, replications), end)
    chain_end = _last(graph, end)
    makespan = chain_end.max(axis=0, initial=0)
    start = end - busy
    _waits(graph, start, end, waited)
    _latest_ends(graph, busy, makespan, latest)
    _critical_paths(graph, start, end, makespan, critical, critical_edge)
    return Completions(
        start,
        end,
        makespan,
        chain_end,
        waited,
        critical,
        critical_edge,
        latest - end,
    )


_BLOCK = 64
"""Replications computed together: their ends of all nodes of a cell stay in the cache."""


def _last(graph: PrecedenceArrays, end: Nanoseconds) -> Nanoseconds:
    """Return the end of the last node of each chain, 0 for a chain without nodes."""
    out = np.zeros((len(graph.chain_first) - 1, end.shape[1]), dtype=np.int64)
    for k, (low, high) in enumerate(
        zip(graph.chain_first, graph.chain_first[1:], strict=False)
    ):
        if high > low:
            out[k] = end[high - 1]
    return out


@njit(cache=True, nogil=True)
def _ends(
    graph: PrecedenceArrays,
    busy: Nanoseconds,
    low: int,
    high: int,
    end: Nanoseconds,
) -> None:
    for n in graph.order:
        own = graph.before[n]
        for r in range(low, high):
            end[n, r] = graph.not_before[n]
        if own >= 0:
            for r in range(low, high):
                end[n, r] = max(end[n, r], end[own, r])
        for e in range(graph.edge_first[n], graph.edge_first[n + 1]):
            source = graph.source[e]
            for r in range(low, high):
                end[n, r] = max(end[n, r], end[source, r])
        for r in range(low, high):
            end[n, r] += busy[n, r]


@njit(cache=True, nogil=True)
def _waits(
    graph: PrecedenceArrays,
    start: Nanoseconds,
    end: Nanoseconds,
    waited: Nanoseconds,
) -> None:
    """Add every wait to the cause of the edge that ended it; a dependency wins a tie."""
    chains = len(graph.chain_first) - 1
    for chain in range(chains):
        for n in range(graph.chain_first[chain], graph.chain_first[chain + 1]):
            if graph.edge_first[n] == graph.edge_first[n + 1]:
                continue
            own = graph.before[n]
            for r in range(start.shape[1]):
                since = end[own, r] if own >= 0 else 0
                if start[n, r] <= since:
                    continue
                cause = -1
                for e in range(graph.edge_first[n], graph.edge_first[n + 1]):
                    if end[graph.source[e], r] == start[n, r]:
                        own_cause = int(graph.cause[e])
                        cause = own_cause if cause < 0 else min(cause, own_cause)
                if cause < 0:  # the clock, not another robot
                    continue
                waited[chain, cause, r] += start[n, r] - since


@njit(cache=True, nogil=True)
def _latest_ends(
    graph: PrecedenceArrays,
    busy: Nanoseconds,
    makespan: Nanoseconds,
    latest: Nanoseconds,
) -> None:
    """Write how late every node may end, by a pass in reverse order."""
    replications = busy.shape[1]
    for n in range(busy.shape[0]):
        for r in range(replications):
            latest[n, r] = makespan[r]
    for k in range(len(graph.order) - 1, -1, -1):
        n = graph.order[k]
        own = graph.before[n]
        for r in range(replications):
            begin = latest[n, r] - busy[n, r]
            if own >= 0:
                latest[own, r] = min(latest[own, r], begin)
            for e in range(graph.edge_first[n], graph.edge_first[n + 1]):
                source = graph.source[e]
                latest[source, r] = min(latest[source, r], begin)


@njit(cache=True, nogil=True)
def _critical_paths(
    graph: PrecedenceArrays,
    start: Nanoseconds,
    end: Nanoseconds,
    makespan: Nanoseconds,
    critical: npt.NDArray[np.bool_],
    critical_edge: npt.NDArray[np.bool_],
) -> None:
    """Mark one critical path a replication, from the end back to the start of the run.

    Where several nodes ended at the right time, a robot's own predecessor is taken before
    another robot's, so that waiting is only marked where it decided.
    """
    for r in range(start.shape[1]):
        n = -1
        for chain in range(len(graph.chain_first) - 1):
            last = graph.chain_first[chain + 1] - 1
            if last >= graph.chain_first[chain] and end[last, r] == makespan[r]:
                n = last
                break
        while n >= 0:
            critical[n, r] = True
            own = graph.before[n]
            since = end[own, r] if own >= 0 else 0
            if since == start[n, r]:
                n = own
                continue
            found = -1
            for e in range(graph.edge_first[n], graph.edge_first[n + 1]):
                if end[graph.source[e], r] == start[n, r]:
                    found = e
                    break
            if found < 0:  # the clock let it start
                break
            critical_edge[found, r] = True
            n = graph.source[found]
