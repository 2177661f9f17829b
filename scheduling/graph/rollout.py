"""When every node starts and ends if all run as early as the graph lets them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit

from planning.transforms import Array, Indices
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.graph.total_order import planned_ranks

NANOSECONDS = 1_000_000_000


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
        """When the last node ends."""
        ends = [e[-1].item() for e in self.end if len(e)]
        return max(ends, default=0)

    def wait(self, robot: int) -> float | int:
        """Return the end of a robot's last node minus the sum of its durations."""
        if len(self.end[robot]) == 0:
            return 0
        busy = self.duration[robot].sum()
        value: float | int = (self.end[robot][-1] - busy).item()
        return value


@njit(cache=True, nogil=True)
def _longest_paths(
    first: Indices,
    order: Indices,
    robot: Indices,
    target_first: Indices,
    source: Indices,
    duration: npt.NDArray[Any],
    start: npt.NDArray[Any],
    end: npt.NDArray[Any],
) -> None:
    for n in order:
        t = end[n - 1] if n > first[robot[n]] else 0 * duration[n]
        for e in range(target_first[n], target_first[n + 1]):
            if end[source[e]] > t:
                t = end[source[e]]
        start[n] = t
        end[n] = t + duration[n]


@njit(cache=True, nogil=True)
def _longest_paths_back(
    last: Indices,
    order: Indices,
    robot: Indices,
    source_first: Indices,
    target: Indices,
    duration: Array,
    latest: Array,
) -> None:
    for k in range(len(order)):
        n = order[len(order) - 1 - k]
        if n < last[robot[n]]:
            latest[n] = latest[n + 1] - duration[n + 1]
        for e in range(source_first[n], source_first[n + 1]):
            before = latest[target[e]] - duration[target[e]]
            if before < latest[n]:
                latest[n] = before


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
            nominal durations by default. Indices stay integers.
        ranks: place of every node in the total order, where that is known already.
    """
    chosen = [
        np.asarray(d) for d in (durations or [chain.duration for chain in tpg.chains])
    ]
    integer = all(np.issubdtype(d.dtype, np.integer) for d in chosen)
    dtype: type[np.int64] | type[np.float64] = np.int64 if integer else np.float64
    ranks = planned_ranks(tpg.chains) if ranks is None else ranks
    first = np.cumsum([0, *(len(r) for r in ranks)]).astype(np.int64)
    total = int(first[-1])
    duration = np.concatenate([*chosen, np.empty(0)]).astype(dtype)
    if integer and chosen:
        duration = np.concatenate(chosen).astype(np.int64)
    rank = np.concatenate([*ranks, np.empty(0, dtype=np.int64)])
    target = first[tpg.edges[:, 2]] + tpg.edges[:, 3]
    source = first[tpg.edges[:, 0]] + tpg.edges[:, 1]
    by_target = np.argsort(target, kind="stable")
    start = np.zeros(total, dtype=dtype)
    end = np.zeros(total, dtype=dtype)
    _longest_paths(
        first,
        np.argsort(rank).astype(np.int64),
        np.repeat(np.arange(len(ranks)), np.diff(first)).astype(np.int64),
        np.searchsorted(target[by_target], np.arange(total + 1)).astype(np.int64),
        source[by_target].astype(np.int64),
        duration,
        start,
        end,
    )
    cut = [slice(a, b) for a, b in pairwise(first)]
    return Rollout(
        tuple(start[c] for c in cut),
        tuple(end[c] for c in cut),
        tuple(duration[c] for c in cut),
    )


def latest_ends(
    tpg: TemporalPlanGraph,
    rollout: Rollout,
    *,
    ranks: Sequence[Indices] | None = None,
) -> list[Array]:
    """Return when every node may end at the latest for the same makespan [s].

    Args:
        tpg: the graph.
        rollout: of it, with durations in seconds.
        ranks: place of every node in the total order, where that is known already.
    """
    ranks = planned_ranks(tpg.chains) if ranks is None else ranks
    first = np.cumsum([0, *(len(r) for r in ranks)]).astype(np.int64)
    source = first[tpg.edges[:, 0]] + tpg.edges[:, 1]
    target = first[tpg.edges[:, 2]] + tpg.edges[:, 3]
    by_source = np.argsort(source, kind="stable")
    latest: Array = np.full(int(first[-1]), float(rollout.makespan))
    _longest_paths_back(
        first[1:] - 1,
        np.argsort(np.concatenate([*ranks, np.empty(0, dtype=np.int64)])),
        np.repeat(np.arange(len(ranks)), np.diff(first)).astype(np.int64),
        np.searchsorted(source[by_source], np.arange(len(latest) + 1)).astype(np.int64),
        target[by_source].astype(np.int64),
        np.concatenate([*rollout.duration, np.empty(0)]).astype(np.float64),
        latest,
    )
    return [latest[a:b] for a, b in pairwise(first)]


def durations_ns(tpg: TemporalPlanGraph) -> list[Indices]:
    """Return the nominal durations rounded to integer nanoseconds, one array a chain."""
    return [
        np.rint(chain.duration * NANOSECONDS).astype(np.int64) for chain in tpg.chains
    ]


def sequential_makespan(
    tpg: TemporalPlanGraph, durations: Sequence[Array] | None = None
) -> float:
    """Return the makespan when one node after the other runs in the planned order [s]."""
    chosen = durations or [chain.duration for chain in tpg.chains]
    return float(sum(float(np.sum(d)) for d in chosen))
