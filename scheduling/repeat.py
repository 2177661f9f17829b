"""The graph of many products, repeated from a pattern: edges and proof of a few copies.

Whether two nodes conflict depends on their paths and loads, which are the same in every copy; contacts are
allowed within one copy alone. So a node that conflicts with one of an earlier copy conflicts with the same
one of every earlier copy, and the last of them is in the copy just before: an edge reaches back no further
than one copy, and a planned wait no further than it states. Edges into a copy are therefore those into the
one before it, shifted, as soon as all their sources exist. This is verified: the graph of some copies is
built and proved as any other, and its edges must repeat.

The invariant then holds for any number of copies. Take a node v of copy m and a robot or an object that
stands for a while in copy n, with which v conflicts. With n = m it was proved in the graph of few copies,
and so it was with n = m - 1 and n = m + 1: v is ordered after the end of that stand in the copy before, and
ahead of its beginning in the copy after. Nodes of one robot are in order, copy after copy; hence v comes
after that stand in all earlier copies and ahead of it in all later.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from planning.errors import PlanInvariantError
from planning.transforms import Indices
from scheduling.build_tpg import connect_nodes
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.copies import Pattern, copied_nodes
from scheduling.graph.task_edges import task_nodes
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.graph.total_order import planned_ranks, transitive_reduction

_MORE = 4
"""Copies that are built beyond those needed before it is given up that edges repeat."""


def repeat_graph(
    tpg: TemporalPlanGraph,
    pattern: Pattern,
) -> TemporalPlanGraph:
    """Return the graph of all products of a pattern, reduced and proved safe.

    Args:
        tpg: of the pattern.
        pattern: how it is repeated.

    Raises:
        PlanInvariantError: a robot or object that stands in one copy is in the way of a motion
            in another, or copies do not repeat.
    """
    least = pattern.reach + 3
    for copies in range(least, least + _MORE + 1):
        if pattern.copies <= copies:
            return connect_nodes(DerivedTpg(copied_nodes(tpg, pattern)))
        cut = pattern.copies - copies
        short = replace(pattern, products=pattern.products - cut * pattern.period)
        few = connect_nodes(DerivedTpg(copied_nodes(tpg, short)))
        lengths = [len(chain) for chain in tpg.chains]
        edges = _Edges(few.edges, few.cause, np.array(lengths, dtype=np.int64))
        if edges.repeat(copies - 2):
            return _whole(tpg, pattern, edges, copies)
    raise PlanInvariantError(
        f"what {least + _MORE} copies of the plan of a product wait for does not repeat"
    )


class _Edges:
    """Type-2 edges of some copies, by the copy of their target.

    Args:
        edges: shape (e, 4).
        cause: shape (e,).
        lengths: nodes of each chain in one copy, shape (chains,).
    """

    def __init__(
        self, edges: Indices, cause: npt.NDArray[np.uint8], lengths: Indices
    ) -> None:
        self.edges, self.cause, self.lengths = edges, cause, lengths
        self._copy = edges[:, 3] // lengths[edges[:, 2]]

    def into(self, copy: int, by: int = 0) -> tuple[Indices, npt.NDArray[np.uint8]]:
        """Return the edges into a copy, counted from 0, and their causes, shifted by copies."""
        own = self._copy == copy
        edges = self.edges[own].copy()
        edges[:, 1] += by * self.lengths[edges[:, 0]]
        edges[:, 3] += by * self.lengths[edges[:, 2]]
        return edges, self.cause[own]

    def repeat(self, copy: int) -> bool:
        """Tell whether the edges into a copy equal those into the one before it, shifted by one."""
        before, why = self.into(copy - 1, 1)
        edges, cause = self.into(copy)
        return np.array_equal(before, edges) and np.array_equal(why, cause)


def _whole(
    tpg: TemporalPlanGraph, pattern: Pattern, few: _Edges, copies: int
) -> TemporalPlanGraph:
    """Return the graph of all copies, with shifted edges of a few."""
    parts = [few.into(copy) for copy in range(copies - 1)]
    steady = copies - 2
    parts += [few.into(steady, by) for by in range(1, pattern.copies - copies + 1)]
    parts.append(few.into(copies - 1, pattern.copies - copies))
    edges = np.concatenate([part for part, _ in parts])
    cause = np.concatenate([why for _, why in parts])
    order = np.lexsort(edges.T[::-1])
    graph = replace(copied_nodes(tpg, pattern), edges=edges[order], cause=cause[order])
    _require_waits(graph)
    return graph


def _require_waits(tpg: TemporalPlanGraph) -> None:
    """Check that edges follow the planned order and keep all task dependencies."""
    order, _ = transitive_reduction(planned_ranks(tpg.chains), tpg.edges)
    nodes = {own.task: own for chain in task_nodes(tpg.chains) for own in chain}
    for a, b in tpg.dependencies.tolist():
        if a not in nodes or b not in nodes:
            continue
        u, v = nodes[a], nodes[b]
        if u.chain != v.chain and not order.precedes(
            u.chain, u.stop - 1, v.chain, v.first
        ):
            raise PlanInvariantError(f"task {b} does not wait for task {a} any more")
