"""Bound of the makespan by the longest path through one more edge."""

from __future__ import annotations

from dataclasses import dataclass

from planning.transforms import Array
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.graph.rollout import earliest_times, latest_ends
from scheduling.graph.total_order import with_edges
from scheduling.shortcuts.rewiring import Edge, Swap, splice_edges

_ROUNDING = 1e-7
"""More than the rounding errors of the length of a path [s]."""


@dataclass(frozen=True)
class EdgeBound:
    """Edges with which a graph ends too late, whatever other edges it gets.

    Attributes:
        end: earliest end of each node, one array per chain [s].
        limit: latest start of each node, one array per chain [s].
    """

    end: list[Array]
    limit: list[Array]

    @staticmethod
    def of(graph: DerivedTpg, swap: Swap, seconds: Array, latest: float) -> EdgeBound:
        """Return the bound for edges that new nodes may get.

        Args:
            graph: the graph before.
            swap: the nodes to be replaced.
            seconds: durations of the new nodes, shape (swap.count,) [s].
            latest: the greatest makespan that is allowed [s].
        """
        tpg = graph.tpg
        edges, _ = splice_edges(tpg.edges, tpg.cause, swap)
        flat = with_edges(graph.flat, edges)
        durations = [chain.duration for chain in tpg.chains]
        durations[swap.chain] = durations[swap.chain].copy()
        durations[swap.chain][swap.first : swap.last + 1] = seconds
        rollout = earliest_times(tpg, durations, flat=flat)
        more = latest - float(rollout.makespan) + _ROUNDING
        ends = latest_ends(tpg, rollout, flat=flat)
        limit = [
            end - own + more for end, own in zip(ends, rollout.duration, strict=True)
        ]
        return EdgeBound(list(rollout.end), limit)

    def excludes(self, edge: Edge) -> bool:
        """Tell whether the longest path through an edge exceeds the allowed makespan."""
        i, u, k, v = edge
        return bool(self.end[i][u] > self.limit[k][v])
