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
    graph: FlatGraph, duration: npt.NDArray[Any], earliest: npt.NDArray[Any]
) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    start, end = np.zeros_like(duration), np.zeros_like(duration)
    for n in graph.order:
        t = earliest[n]
        if n > graph.first[graph.chain[n]]:
            t = max(t, end[n - 1])
        for e in range(graph.edge_first[n], graph.edge_first[n + 1]):
            t = max(t, end[graph.source[e]])
        start[n] = t
        end[n] = t + duration[n]
    return start, end


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
    start, end = _longest_paths(graph, duration, floor)
    cut = [slice(a, b) for a, b in pairwise(graph.first)]
    return Rollout(
        tuple(start[c] for c in cut),
        tuple(end[c] for c in cut),
        tuple(duration[c] for c in cut),
    )


@kernel
def _latest_ends(graph: FlatGraph, duration: Array, makespan: float) -> Array:
    end = np.full(len(duration), makespan)
    for n in graph.order[::-1]:
        start = end[n] - duration[n]
        if n > graph.first[graph.chain[n]]:
            end[n - 1] = min(end[n - 1], start)
        for e in range(graph.edge_first[n], graph.edge_first[n + 1]):
            end[graph.source[e]] = min(end[graph.source[e]], start)
    return end


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
    latest = _latest_ends(flat, duration, float(rollout.makespan))
    return np.split(latest, flat.first[1:-1])
