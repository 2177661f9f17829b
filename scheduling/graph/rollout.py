"""Earliest and latest times of nodes that all run as early as the graph lets them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from planning.kernels import kernel
from planning.transforms import Array, Indices
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.graph.total_order import FlatGraph, flatten, planned_ranks


@dataclass(frozen=True)
class Rollout:
    """Start and end of every node, one array of shape (nodes,) a chain.

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
    graph: FlatGraph, duration: npt.NDArray[Any]
) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    start, end = np.zeros_like(duration), np.zeros_like(duration)
    for n in graph.order:
        t = end[n - 1] if n > graph.first[graph.chain[n]] else 0 * duration[n]
        for e in range(graph.edge_first[n], graph.edge_first[n + 1]):
            t = max(t, end[graph.source[e]])
        start[n] = t
        end[n] = t + duration[n]
    return start, end


def earliest_times(
    tpg: TemporalPlanGraph,
    durations: Sequence[npt.NDArray[Any]] | None = None,
    *,
    ranks: Sequence[Indices] | None = None,
) -> Rollout:
    """Return the earliest start and end of every node: longest paths in the total order.

    Args:
        tpg: the graph.
        durations: one array of shape (nodes,) a chain, floats [s] or integers [ns]; the
            nominal durations by default. Integers stay integers.
        ranks: place of every node in the total order, where that is known already.
    """
    chosen = durations or [chain.duration for chain in tpg.chains]
    duration = np.concatenate(chosen) if chosen else np.empty(0)
    integer = np.issubdtype(duration.dtype, np.integer)
    duration = duration.astype(np.int64 if integer else np.float64)
    graph = flatten(planned_ranks(tpg.chains) if ranks is None else ranks, tpg.edges)
    start, end = _longest_paths(graph, duration)
    cut = [slice(a, b) for a, b in pairwise(graph.first)]
    return Rollout(
        tuple(start[c] for c in cut),
        tuple(end[c] for c in cut),
        tuple(duration[c] for c in cut),
    )


def latest_ends(
    tpg: TemporalPlanGraph, rollout: Rollout, *, ranks: Sequence[Indices] | None = None
) -> list[Array]:
    """Return the latest end of every node that keeps the makespan [s].

    In the graph turned round, a node starts when all that waits for it here has passed.

    Args:
        tpg: the graph.
        rollout: of it, with durations in seconds.
        ranks: place of every node in the total order, where that is known already.
    """
    ranks = planned_ranks(tpg.chains) if ranks is None else ranks
    lengths = np.array([len(chain) for chain in tpg.chains], dtype=np.int64)
    r, u, s, v = tpg.edges.T
    last = len(lengths) - 1
    turned = np.column_stack(
        [last - s, lengths[s] - 1 - v, last - r, lengths[r] - 1 - u]
    )
    graph = flatten([-rank[::-1] for rank in ranks[::-1]], turned)
    duration = np.concatenate([*rollout.duration, np.empty(0)])[::-1].copy()
    start, _ = _longest_paths(graph, duration)
    latest = float(rollout.makespan) - start[::-1]
    return np.split(latest, np.cumsum(lengths)[:-1])
