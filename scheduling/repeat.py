"""Temporal plan graph of many equal products, made from the graph of a few copies of the plan of one product.

Whether two nodes conflict depends on their paths and loads, which are the same in every copy. Contacts are
allowed only within one copy. So if a node conflicts with a node u of one earlier copy, it conflicts with the
u of every earlier copy, and needs an edge only from the last of these, in the copy just before. An edge from
a planned wait spans as many copies as the plan specifies. Hence, after the first few copies, the edges
into a copy are the edges into the copy before it, shifted by one copy. This is verified: the graph of a few
copies is built and checked like any other graph, and its edges must repeat.

The safety invariant then holds for any number of copies. Let a node v of copy m conflict with a robot at rest,
or an object at rest, in copy n. For n = m - 1, m and m + 1 the order is proved in the graph of a few copies: v
comes after the end of that rest in copy m - 1, and before its beginning in copy m + 1. The nodes of a robot are
ordered copy after copy; hence v comes after the rest in all earlier copies and before it in all later ones.
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

_EXTRA_COPIES = 4
"""Most copies that are built beyond those needed, until edges repeat."""


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
    for copies in range(least, least + _EXTRA_COPIES + 1):
        if pattern.copies <= copies:
            return connect_nodes(DerivedTpg(copied_nodes(tpg, pattern)))
        cut = pattern.copies - copies
        short = replace(pattern, products=pattern.products - cut * pattern.period)
        few = connect_nodes(DerivedTpg(copied_nodes(tpg, short)))
        lengths = [len(chain) for chain in tpg.chains]
        edges = _Edges(few.edges, few.cause, np.array(lengths, dtype=np.int64))
        if edges.repeat(copies - 2):
            return _all_copies(tpg, pattern, edges, copies)
    raise PlanInvariantError(
        f"what {least + _EXTRA_COPIES} copies of the plan of a product wait for does not repeat"
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


def _all_copies(
    tpg: TemporalPlanGraph, pattern: Pattern, few: _Edges, copies: int
) -> TemporalPlanGraph:
    """Return the graph of all copies, from the edges of a few copies, shifted."""
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
