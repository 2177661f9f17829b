"""Completion times of many replications at once: longest paths in a max-plus algebra.

Where every node starts as soon as what it waits for is complete, its end is the greatest end of
its predecessors plus its own time. That needs no events: one pass over the nodes in a total
order, for all replications side by side, in the same integer nanoseconds as the event engine.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from planning.kernels import kernel
from twin.durations import Nanoseconds
from twin.engine.bulk.critical_paths import explain
from twin.engine.bulk.flat_graph import PrecedenceArrays, last_ends

_BLOCK = 64
"""Replications computed together: their ends of all nodes of a cell stay in the cache."""


@dataclass(frozen=True)
class Completions:
    """Node times, waits and critical paths of replications.

    Attributes:
        start_ns, end_ns: of every node, shape (nodes, replications) [ns].
        makespan_ns: shape (replications,) [ns].
        chain_end_ns: end of each robot's last node, shape (chains, replications) [ns].
        waited_ns: see explain.
        critical, critical_edge: see explain.
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


def makespans(graph: PrecedenceArrays, busy_ns: Nanoseconds) -> Nanoseconds:
    """Return the makespan of every replication.

    Args:
        graph: what must wait for what.
        busy_ns: stall and duration of each node together, shape (nodes, replications) [ns].

    Returns:
        Shape (replications,) [ns].
    """
    end = _end_times(graph, np.ascontiguousarray(busy_ns, dtype=np.int64))
    return np.asarray(last_ends(graph, end).max(axis=0, initial=0), dtype=np.int64)


def completions(graph: PrecedenceArrays, busy_ns: Nanoseconds) -> Completions:
    """Return when everything happens in every replication, and what decided it.

    Args:
        graph: what must wait for what.
        busy_ns: stall and duration of each node together, shape (nodes, replications) [ns].
    """
    busy = np.ascontiguousarray(busy_ns, dtype=np.int64)
    end = _end_times(graph, busy)
    chain_end = last_ends(graph, end)
    makespan = chain_end.max(axis=0, initial=0)
    start = end - busy
    latest = np.empty_like(busy)
    _latest_ends(graph, busy, makespan, latest)
    waited, critical, critical_edge = explain(graph, start, end)
    slack = latest - end
    return Completions(
        start, end, makespan, chain_end, waited, critical, critical_edge, slack
    )


def _end_times(graph: PrecedenceArrays, busy: Nanoseconds) -> Nanoseconds:
    end = np.empty_like(busy)
    for first in range(0, busy.shape[1], _BLOCK):
        _ends(graph, busy, first, min(first + _BLOCK, busy.shape[1]), end)
    return end


@kernel
def _ends(
    graph: PrecedenceArrays,
    busy: Nanoseconds,
    low: int,
    high: int,
    end: Nanoseconds,
) -> None:
    for n in graph.order:
        own = n - 1 if n > graph.first[graph.chain[n]] else -1
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


@kernel
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
        own = n - 1 if n > graph.first[graph.chain[n]] else -1
        for r in range(replications):
            begin = latest[n, r] - busy[n, r]
            if own >= 0:
                latest[own, r] = min(latest[own, r], begin)
            for e in range(graph.edge_first[n], graph.edge_first[n + 1]):
                source = graph.source[e]
                latest[source, r] = min(latest[source, r], begin)
