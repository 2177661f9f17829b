"""Order between chains as vector clocks, and transitive reduction in one pass.

The clock of a node holds, for each robot, its last node that must be complete before the node
may start. One look-up tells whether one node precedes another.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from planning.errors import PlanInvariantError
from planning.transforms import Indices


@dataclass(frozen=True)
class NodeOrder:
    """What precedes what in a graph of chains.

    Attributes:
        first: number of the first node of each robot when all nodes are counted, shape
            (robots + 1,).
        clock: last node of each robot that must be complete before a node starts, -1 for
            none, shape (all nodes, robots).
    """

    first: Indices
    clock: Indices

    def of(self, robot: int) -> Indices:
        """Return the clocks of a robot's nodes, shape (nodes, robots)."""
        return self.clock[self.first[robot] : self.first[robot + 1]]

    def precedes(self, robot_u: int, u: int, robot_v: int, v: int) -> bool:
        """Tell whether node u must be complete before node v starts, in O(1)."""
        return bool(self.clock[self.first[robot_v] + v, robot_u] >= u)

    def last_before(self, robot: int, other: int) -> Indices:
        """Return, for each node of ``robot``, the last node of ``other`` it waits for, or -1."""
        return self.of(robot)[:, other]

    def first_after(
        self, robot: int, other: int, nodes: Indices | None = None
    ) -> Indices:
        """Return, for nodes of ``robot``, the first node of ``other`` that waits for each.

        The number of nodes of ``other`` stands for none.

        Args:
            robot: whose nodes.
            other: who waits.
            nodes: which of them, all by default.
        """
        waits_for = np.ascontiguousarray(self.of(other)[:, robot])
        if nodes is None:
            nodes = np.arange(self.first[robot + 1] - self.first[robot])
        return np.searchsorted(waits_for, nodes, side="left").astype(np.int64)


@njit(cache=True, nogil=True)
def _clocks(
    first: Indices,
    robot: Indices,
    rank_order: Indices,
    target_first: Indices,
    source_robot: Indices,
    source_node: Indices,
    keep: npt.NDArray[np.bool_],
) -> Indices:
    """Return all clocks; ``keep`` becomes False for edges that other paths imply.

    Edges are grouped by target: those into the node counted n are ``target_first[n]`` up to
    ``target_first[n + 1]``.
    """
    robots = len(first) - 1
    clock = np.full((len(robot), robots), -1)
    for n in rank_order:
        own = robot[n]
        mine = clock[n]
        if n > first[own]:
            mine[:] = clock[n - 1]
            mine[own] = n - 1 - first[own]
        lo, hi = target_first[n], target_first[n + 1]
        for e in range(lo, hi):
            r, u = source_robot[e], source_node[e]
            if mine[r] >= u:
                keep[e] = False
                continue
            for other in range(lo, hi):
                if other == e:
                    continue
                s, w = source_robot[other], source_node[other]
                if s == r:
                    if w > u or (w == u and other < e):
                        keep[e] = False
                        break
                elif clock[first[s] + w, r] >= u:
                    keep[e] = False
                    break
        for e in range(lo, hi):
            r, u = source_robot[e], source_node[e]
            theirs = clock[first[r] + u]
            for k in range(robots):
                if theirs[k] > mine[k]:
                    mine[k] = theirs[k]
            if u > mine[r]:
                mine[r] = u
    return clock


def order_and_reduce(
    ranks: Sequence[Indices], edges: Indices
) -> tuple[NodeOrder, npt.NDArray[np.bool_]]:
    """Return the order that edges impose, and which of them say it already.

    Args:
        ranks: place of every node in the total order, one array a robot, see ``planned_ranks``.
        edges: type-2 edges, shape (e, 4).

    Returns:
        The order, and True for the edges of the transitive reduction, shape (e,). Of equal
        edges the first one stays.

    Raises:
        PlanInvariantError: an edge goes against the total order.
    """
    edges = np.asarray(edges, dtype=np.int64).reshape(-1, 4)
    first = np.cumsum([0, *(len(r) for r in ranks)]).astype(np.int64)
    rank = np.concatenate([*ranks, np.empty(0, dtype=np.int64)]).astype(np.int64)
    robot = np.repeat(np.arange(len(ranks)), np.diff(first)).astype(np.int64)
    source = first[edges[:, 0]] + edges[:, 1]
    target = first[edges[:, 2]] + edges[:, 3]
    against = np.flatnonzero(rank[source] >= rank[target])
    if len(against):
        r, u, s, v = edges[against[0]]
        raise PlanInvariantError(
            f"the edge from node {u} of robot {r} to node {v} of robot {s} goes against"
            " the planned order"
        )
    by_target = np.argsort(target, kind="stable")
    target_first = np.searchsorted(target[by_target], np.arange(len(rank) + 1))
    keep_sorted = np.ones(len(edges), dtype=np.bool_)
    clock = _clocks(
        first,
        robot,
        np.argsort(rank, kind="stable").astype(np.int64),
        target_first.astype(np.int64),
        np.ascontiguousarray(edges[by_target, 0]),
        np.ascontiguousarray(edges[by_target, 1]),
        keep_sorted,
    )
    keep = np.empty(len(edges), dtype=np.bool_)
    keep[by_target] = keep_sorted
    return NodeOrder(first, clock), keep
