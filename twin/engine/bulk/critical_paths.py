"""Critical paths and causes of waiting, from node times of either engine."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from planning.kernels import kernel
from twin.durations import Nanoseconds
from twin.engine.bulk.flat_graph import PrecedenceArrays, last_ends

OTHER = 2
"""Cause of a wait that the plan did not ask for: a message under way, the clock, a turn."""


def explain(
    graph: PrecedenceArrays, start_ns: Nanoseconds, end_ns: Nanoseconds
) -> tuple[Nanoseconds, npt.NDArray[np.bool_], npt.NDArray[np.bool_]]:
    """Return waiting times by cause, and the critical path of each replication.

    Args:
        graph: what must wait for what.
        start_ns, end_ns: of every node, shape (nodes, replications) [ns].

    Returns:
        What each robot waited for, shape (chains, 3, replications) [ns], by TASK_DEPENDENCY,
        MOTION_CONFLICT and OTHER: the time until the last of the nodes waited for was complete
        is its edge's, a dependency's on a tie, and what is left is OTHER. True where a node is
        on a critical path, shape (nodes, replications), and the same for edges, shape
        (edges, replications); there is one path a replication, and a robot's own predecessor
        comes before another robot's.
    """
    start = np.ascontiguousarray(start_ns, dtype=np.int64)
    end = np.ascontiguousarray(end_ns, dtype=np.int64)
    nodes, replications = start.shape
    waited = np.zeros((len(graph.first) - 1, 3, replications), dtype=np.int64)
    critical = np.zeros((nodes, replications), dtype=np.bool_)
    critical_edge = np.zeros((len(graph.source), replications), dtype=np.bool_)
    _waits(graph, start, end, waited)
    _critical_paths(graph, start, end, last_ends(graph, end), critical, critical_edge)
    return waited, critical, critical_edge


@kernel
def _latest_source(
    graph: PrecedenceArrays, end: Nanoseconds, n: int, r: int
) -> tuple[int, int]:
    """Return the edge whose source was complete last, and when; -1 and 0 without edges."""
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
    graph: PrecedenceArrays,
    start: Nanoseconds,
    end: Nanoseconds,
    waited: Nanoseconds,
) -> None:
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


@kernel
def _critical_paths(
    graph: PrecedenceArrays,
    start: Nanoseconds,
    end: Nanoseconds,
    last_end: Nanoseconds,
    critical: npt.NDArray[np.bool_],
    critical_edge: npt.NDArray[np.bool_],
) -> None:
    """Mark one critical path a replication, from the end back to the start of the run."""
    for r in range(start.shape[1]):
        n, latest = -1, -1
        for chain in range(len(graph.first) - 1):
            last = graph.first[chain + 1] - 1
            if last >= graph.first[chain] and last_end[chain, r] > latest:
                n, latest = last, last_end[chain, r]
        while n >= 0:
            critical[n, r] = True
            own = n - 1 if n > graph.first[graph.chain[n]] else -1
            since = end[own, r] if own >= 0 else 0
            edge, done = _latest_source(graph, end, n, r)
            if graph.not_before[n] > max(since, done):
                break  # the clock let it start, nobody else
            if edge >= 0 and done > since:
                critical_edge[edge, r] = True
                n = graph.source[edge]
            else:
                n = own
