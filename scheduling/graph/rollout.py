"""Earliest start and end times and latest end times of the nodes of a temporal plan graph.

In the earliest schedule every node starts as soon as the graph allows. Latest end times keep its makespan.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from planning.kernels import kernel
from planning.transforms import Array
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.graph.total_order import FlatGraph, flatten_graph, planned_ranks

_EXACT = 2.0**52
"""Sums of integers below this are exact in floats, with room for the error of their estimate."""


@dataclass(frozen=True)
class Rollout:
    """Start and end of every node, one array of shape (nodes,) per chain.

    Attributes:
        start, end: [s] or [ns], as the durations were.
        duration: what it was computed from.
    """

    start: tuple[npt.NDArray[Any], ...]
    end: tuple[npt.NDArray[Any], ...]
    duration: tuple[npt.NDArray[Any], ...]

    @property
    def makespan(self) -> float | int:
        """End of the last node, in the unit of the durations."""
        ends = [e[-1].item() for e in self.end if len(e)]
        return max(ends, default=0)


@kernel
def _longest_paths(
    graph: FlatGraph, duration: Array, earliest: Array, start: Array, end: Array
) -> None:
    """Write the earliest start and end of each node, shape (nodes,)."""
    for n in graph.order:
        t = earliest[n]
        if n > graph.first[graph.chain[n]]:
            t = max(t, end[n - 1])
        for e in range(graph.edge_first[n], graph.edge_first[n + 1]):
            t = max(t, end[graph.source[e]])
        start[n] = t
        end[n] = t + duration[n]


def earliest_times(
    tpg: TemporalPlanGraph,
    durations: Sequence[npt.NDArray[Any]] | None = None,
    *,
    flat: FlatGraph | None = None,
    earliest: Sequence[npt.NDArray[Any]] | None = None,
) -> Rollout:
    """Return the earliest start and end of every node: longest paths in the total order.

    Args:
        tpg: the graph.
        durations: one array of shape (nodes,) a chain, floats [s] or integers [ns]; the
            nominal durations by default. Integers stay integers.
        flat: the graph as flat arrays, where they are known already.
        earliest: before which no node starts, as the durations; 0 by default.
    """
    chosen = durations or [chain.duration for chain in tpg.chains]
    duration = np.concatenate(chosen) if chosen else np.empty(0)
    integer = np.issubdtype(duration.dtype, np.integer)
    duration = duration.astype(np.int64 if integer else np.float64)
    graph = flat or flatten_graph(planned_ranks(tpg.chains), tpg.edges)
    floor = np.zeros_like(duration)
    if earliest is not None:
        floor = np.concatenate(earliest).astype(duration.dtype)
    start, end = _times(graph, duration, floor)
    cut = [slice(a, b) for a, b in pairwise(graph.first)]
    return Rollout(
        tuple(start[c] for c in cut),
        tuple(end[c] for c in cut),
        tuple(duration[c] for c in cut),
    )


def _times(
    graph: FlatGraph, duration: npt.NDArray[Any], earliest: npt.NDArray[Any]
) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """Return the earliest start and end of each node, of the type of the durations, shape (nodes,)."""
    dtype = duration.dtype
    if float(duration.sum(dtype=float) + earliest.max(initial=0)) < _EXACT:
        # Sums of such integers are exact in floats: the kernel need not be recompiled for integers.
        duration = duration.astype(float, copy=False)
        earliest = earliest.astype(float, copy=False)
    start, end = np.empty_like(duration), np.empty_like(duration)
    _longest_paths(graph, duration, earliest, start, end)
    return start.astype(dtype, copy=False), end.astype(dtype, copy=False)


@kernel
def _latest_ends(graph: FlatGraph, duration: Array, end: Array) -> None:
    """Lower the latest end of each node, the makespan at first, shape (nodes,)."""
    for n in graph.order[::-1]:
        start = end[n] - duration[n]
        if n > graph.first[graph.chain[n]]:
            end[n - 1] = min(end[n - 1], start)
        for e in range(graph.edge_first[n], graph.edge_first[n + 1]):
            end[graph.source[e]] = min(end[graph.source[e]], start)


def latest_ends(
    tpg: TemporalPlanGraph, rollout: Rollout, *, flat: FlatGraph | None = None
) -> list[Array]:
    """Return the latest end of every node that keeps the makespan [s].

    Args:
        tpg: the graph.
        rollout: of it, with durations in seconds.
        flat: the graph as flat arrays, where they are known already.
    """
    flat = flat or flatten_graph(planned_ranks(tpg.chains), tpg.edges)
    duration = np.concatenate([*rollout.duration, np.empty(0)])
    latest = np.full(len(duration), float(rollout.makespan))
    _latest_ends(flat, duration, latest)
    return np.split(latest, flat.first[1:-1])
