"""Time windows between tasks: elapsed times, violations, and edges that delay robots so that windows are kept.

A time window bounds the time from the end of one task to the start of another. The second task could start too
late if it also waits for a slow third robot. Timed edges prevent this: they delay the first task until the
remaining path from the third robot to the second task is short enough, or until the source of the edge is
complete. A timed edge never starts at a node that waits for the delayed task, so there is no cycle, and every
execution ends under any delays.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from planning.kernels import kernel
from planning.tasks.task import TimeWindow
from planning.transforms import Indices
from scheduling.graph.rollout import earliest_times
from scheduling.graph.task_edges import sequential_order
from scheduling.graph.temporal_plan_graph import EVER, Causes, TemporalPlanGraph
from scheduling.graph.total_order import FlatGraph, flatten_graph, planned_ranks

Times = npt.NDArray[np.int64]

_NANOSECONDS = 1_000_000_000

_NO_WAY = -1
"""Length of the path from a node that does not lead to the target."""


def window_nodes(tpg: TemporalPlanGraph) -> Indices:
    """Return the nodes of each window, numbered chain by chain, shape (windows, 3).

    The first node of the work that opens it, the last one, and the one that is due; EARLIER for what was done
    before. That is the same for a contracted graph, whose nodes are of one task each.
    """
    first, last = (
        {TimeWindow.EARLIER: TimeWindow.EARLIER},
        {TimeWindow.EARLIER: TimeWindow.EARLIER},
    )
    tasks = [chain.task for chain in tpg.chains]
    for number, task in enumerate(np.concatenate(tasks).tolist() if tasks else ()):
        first.setdefault(task, number)
        last[task] = number
    rows = [(first[w.begun], last[w.done], first[w.due]) for w in tpg.windows]
    return np.array(rows, dtype=np.int64).reshape(-1, 3)


def window_opening_times(
    tpg: TemporalPlanGraph, end: npt.NDArray[np.int64]
) -> dict[int, int]:
    """Return the end times of completed tasks that opened windows, by their index.

    Args:
        tpg: the graph.
        end: of every node, chain by chain; negative for what has not ended.
    """
    nodes = zip(tpg.windows, window_nodes(tpg)[:, 1].tolist(), strict=True)
    return {
        window.done: int(end[done])
        for window, done in nodes
        if done != TimeWindow.EARLIER and end[done] >= 0
    }


def window_gaps(
    tpg: TemporalPlanGraph, start: npt.NDArray[np.generic], end: npt.NDArray[np.generic]
) -> npt.NDArray[np.generic]:
    """Return the elapsed time from the opening of each window to its due task.

    Args:
        tpg: the graph.
        start, end: of every node, chain by chain, shape (nodes, ...).

    Returns:
        Shape (windows, ...), in the unit of the times: whole numbers are nanoseconds.
    """
    nodes = window_nodes(tpg)
    since = _NANOSECONDS if np.issubdtype(end.dtype, np.integer) else 1.0
    gaps = np.empty((len(nodes), *end.shape[1:]), dtype=end.dtype)
    for k, (window, (_, done, due)) in enumerate(zip(tpg.windows, nodes, strict=True)):
        opened = -window.ago * since if done == TimeWindow.EARLIER else end[done]
        gaps[k] = start[due] - np.asarray(opened).astype(end.dtype)
    return gaps


def least_gaps(tpg: TemporalPlanGraph, busy: Times) -> Times:
    """Return the least elapsed time of each window if it is opened late, shape (windows, r).

    Args:
        tpg: the graph.
        busy: duration of every node in r cases, chain by chain, shape (nodes, r).
    """
    graph = flatten_graph(planned_ranks(tpg.chains), tpg.edges)
    ever = np.full(len(tpg.edges), EVER, dtype=np.int64)
    rows = []
    for window, (_, done, due) in zip(
        tpg.windows, window_nodes(tpg).tolist(), strict=True
    ):
        longest = _longest_paths_to(graph, ever, busy, due, -1)
        if done == TimeWindow.EARLIER:
            rows.append(longest.max(axis=0) + round(window.ago * _NANOSECONDS))
        else:
            rows.append(longest[done] - busy[done])
    return np.array(rows, dtype=np.int64).reshape(-1, busy.shape[1])


def plan_cost(tpg: TemporalPlanGraph) -> tuple[float, float]:
    """Return the window violations of a plan at nominal times, and its makespan: less is better [s]."""
    times = earliest_times(tpg)
    if not tpg.windows:
        return 0.0, float(times.makespan)
    start, end = np.concatenate(times.start), np.concatenate(times.end)
    most = [np.inf if w.most is None else w.most for w in tpg.windows]
    late = np.maximum(window_gaps(tpg, start, end) - np.array(most), 0.0)
    return float(late.sum()), float(times.makespan)


def with_window_hold_edges(
    tpg: TemporalPlanGraph, busy: Times, share: float, cause: int
) -> TemporalPlanGraph:
    """Return a graph with edges that delay the opening of windows, its own ones first.

    What is held back for one window counts for the others: all are looked at from the last to the first,
    and once more from the first to the last. Each robot that the due node needs gets an equal part of the
    probability that it is too late.

    Args:
        tpg: the graph.
        busy: durations of every node that were drawn, chain by chain, shape (nodes, draws) [ns].
        share: of the draws in which what is due is to be in time.
        cause: of the waits that are added.
    """
    ranks = planned_ranks(tpg.chains)
    place = np.concatenate([*ranks, np.empty(0, dtype=np.int64)])
    nodes = window_nodes(tpg)
    timed = [
        k
        for k, window in enumerate(tpg.windows)
        if window.most is not None and window.begun != TimeWindow.EARLIER
    ]
    timed.sort(key=lambda k: (int(place[nodes[k, 0]]), k))
    own: dict[int, tuple[Indices, Indices]] = {}

    def graph() -> tuple[FlatGraph, TemporalPlanGraph]:
        held = _with_patience(tpg, own, cause)
        return followed_order(flatten_graph(ranks, held.edges), held), held

    for k in (*reversed(timed), *timed):
        own.pop(k, None)
        flat, held = graph()
        most = _NANOSECONDS * (tpg.windows[k].most or 0.0)
        waits = held.patience[flat.row]
        late = _last_late(flat, waits, busy, nodes[k], most, share)
        if late:
            rows = _as_edges(flat, list(late), int(nodes[k, 0]))
            own[k] = rows, np.array(list(late.values()), dtype=np.int64)
    return graph()[1]


def _with_patience(
    tpg: TemporalPlanGraph, more: Mapping[int, tuple[Indices, Indices]], cause: int
) -> TemporalPlanGraph:
    """Return a graph with further edges, each with a time limit."""
    edges = np.concatenate([tpg.edges, *(rows for rows, _ in more.values())])
    causes: Causes = np.full(len(edges) - len(tpg.edges), cause, dtype=np.uint8)
    ever = np.full(len(tpg.edges), EVER, dtype=np.int64)
    return replace(
        tpg,
        edges=edges,
        cause=np.concatenate([tpg.cause, causes]),
        patience=np.concatenate([ever, *(times for _, times in more.values())]),
    )


def followed_order(graph: FlatGraph, tpg: TemporalPlanGraph) -> FlatGraph:
    """Return a graph with an order that its edges follow, where they contradict the planned one."""
    place = np.empty_like(graph.order)
    place[graph.order] = np.arange(len(place))
    target = np.repeat(np.arange(len(place)), np.diff(graph.edge_first))
    if np.all(place[graph.source] < place[target]):
        return graph
    return graph._replace(order=np.fromiter(sequential_order(tpg), dtype=np.int64))


def _last_late(
    graph: FlatGraph,
    patience: Times,
    busy: Times,
    window: Indices,
    most: float,
    share: float,
) -> dict[int, int]:
    """Return the last node of each chain with too long a path behind it, and the delay after which it fits.

    Args:
        graph: its order follows its edges.
        patience: of its edges.
        busy: of every node in some draws.
        window: its nodes, see ``window_nodes``.
        most: time that may pass in it.
        share: of the draws in which it is to be kept.
    """
    begun, done, due = window.tolist()
    own = busy[begun : done + 1].sum(axis=0)
    # What is held back waits for what comes before it anyway.
    before = _longest_paths_to(graph, patience, busy[:, :1].copy(), begun, -1)
    longest = _longest_paths_to(graph, patience, busy, due, begun)
    free = (
        (longest[:, 0] != _NO_WAY) & (before[:, 0] == _NO_WAY) & ~_after(graph, begun)
    )
    chains = np.unique(graph.chain[free]).tolist()
    late = 1.0 - (1.0 - share) / max(len(chains), 1)
    found = {}
    for chain in chains:
        nodes = np.flatnonzero(free & (graph.chain == chain))
        # What comes before a node that is in time is later still: one look at the last that is not.
        low, high = 0, len(nodes)
        while low < high:
            middle = (low + high) // 2
            need = np.quantile(longest[nodes[middle]] - own, late, method="higher")
            if need > most:
                low, found[int(nodes[middle])] = middle + 1, int(need - most)
            else:
                high = middle
        for node in nodes[: max(low - 1, 0)].tolist():
            found.pop(node, None)
    return found


def _as_edges(graph: FlatGraph, sources: list[int], begun: int) -> Indices:
    first, to = graph.first, int(graph.chain[begun])
    rows = [
        (k, node - int(first[k]), to, begun - int(first[to]))
        for node in sources
        for k in [int(graph.chain[node])]
    ]
    return np.array(rows, dtype=np.int64).reshape(-1, 4)


@kernel
def _after(graph: FlatGraph, node: int) -> npt.NDArray[np.bool_]:
    """Return the nodes reachable from a node, itself included."""
    after = np.zeros(len(graph.order), np.bool_)
    after[node] = True
    for n in graph.order:
        if n > graph.first[graph.chain[n]] and after[n - 1]:
            after[n] = True
        for e in range(graph.edge_first[n], graph.edge_first[n + 1]):
            if after[graph.source[e]]:
                after[n] = True
    return after


@kernel
def _longest_paths_to(
    graph: FlatGraph, patience: Times, busy: Times, due: int, but: int
) -> Times:
    """Return the longest path from the start of each node to the start of one, shape (nodes, r).

    Paths through the node ``but`` are excluded.
    """
    longest = np.full(busy.shape, _NO_WAY, np.int64)
    longest[due] = 0
    for n in graph.order[::-1]:
        if longest[n, 0] == _NO_WAY or n == but:
            continue
        if n != due:
            longest[n] += busy[n]
        if n > graph.first[graph.chain[n]]:
            longest[n - 1] = np.maximum(longest[n - 1], longest[n])
        for e in range(graph.edge_first[n], graph.edge_first[n + 1]):
            source = graph.source[e]
            if patience[e] < EVER:
                early = np.maximum(busy[source] - patience[e], 0)
                longest[source] = np.maximum(
                    longest[source], np.maximum(longest[n] - early, 0)
                )
            else:
                longest[source] = np.maximum(longest[source], longest[n])
    return longest
