"""Precedence of nodes by ancestor sets, as bits of integers."""

from __future__ import annotations

from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter

import numpy as np

from planning.transforms import Indices
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph

_BLOCK = 4096


@dataclass(frozen=True)
class Precedence:
    """Precedence between nodes.

    Attributes:
        complete: ``complete[a][b][v]`` is how many of the first nodes of chain ``a`` must be
            complete before node ``v`` of chain ``b`` may start.
    """

    complete: tuple[tuple[Indices, ...], ...]

    def precedes(self, a: int, u: int, b: int, v: int) -> bool:
        """Tell whether node u of chain a must be complete before node v of chain b starts."""
        return bool(self.complete[a][b][v] > u)


def find_precedence(tpg: TemporalPlanGraph) -> Precedence | None:
    """Return the order that type-1 and type-2 edges impose, None if they form a cycle."""
    lengths = [len(chain) for chain in tpg.chains]
    first = np.cumsum([0, *lengths]).tolist()
    total = first[-1]
    sources: list[list[int]] = [[] for _ in range(total)]
    for a, length in enumerate(lengths):
        for v in range(1, length):
            sources[first[a] + v].append(first[a] + v - 1)
    for a, u, b, v in tpg.edges.tolist():
        sources[first[b] + v].append(first[a] + u)
    try:
        order = list(TopologicalSorter(dict(enumerate(sources))).static_order())
    except CycleError:
        return None
    complete = [[np.zeros(n, dtype=np.int64) for n in lengths] for _ in lengths]
    for a, length in enumerate(lengths):
        for start in range(0, length, _BLOCK):
            stop = min(start + _BLOCK, length)
            counts = _ancestors(sources, order, first[a] + start, first[a] + stop)
            for b in range(len(lengths)):
                complete[a][b] += counts[first[b] : first[b + 1]]
    return Precedence(tuple(tuple(row) for row in complete))


def _ancestors(
    sources: list[list[int]], order: list[int], start: int, stop: int
) -> Indices:
    """Return, for every node, how many of the nodes ``range(start, stop)`` precede it."""
    bits = [0] * len(sources)
    for v in order:
        mine = 0
        for u in sources[v]:
            mine |= bits[u]
            if start <= u < stop:
                mine |= 1 << (u - start)
        bits[v] = mine
    return np.array([b.bit_count() for b in bits], dtype=np.int64)
