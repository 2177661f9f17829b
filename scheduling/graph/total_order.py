"""Total order of all nodes of a temporal plan graph, and array operations on graphs in this order.

Nodes are sorted by planned start, then by task index, then by position in the task. Robot indices never break a
tie. Every edge between robots follows this order, so the graph has no cycle.

Precedence between robots is stored as vector clocks. The clock of a node holds, for each robot, its last node
that must be complete before the node may start. One look-up tells whether one node precedes another, and
transitive reduction takes one pass.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from planning.errors import PlanInvariantError
from planning.kernels import kernel
from planning.transforms import Indices
from scheduling.graph.temporal_plan_graph import NodeChain


def planned_ranks(chains: Sequence[NodeChain]) -> tuple[Indices, ...]:
    """Return the position of every node in the total order, one array of shape (nodes,) per chain.

    Raises:
        PlanInvariantError: a robot's own nodes are not in this order.
    """
    if not chains:
        return ()
    start = np.concatenate([c.planned_start for c in chains])
    task = np.concatenate([c.task for c in chains])
    node = np.concatenate([np.arange(len(c)) for c in chains])
    rank = np.empty(len(start), dtype=np.int64)
    rank[np.lexsort((node, task, start))] = np.arange(len(start))
    bounds = np.cumsum([0, *(len(c) for c in chains)])
    ranks = tuple(rank[a:b] for a, b in pairwise(bounds))
    for chain, own in zip(chains, ranks, strict=True):
        bad = np.flatnonzero(np.diff(own) < 0)
        if len(bad):
            k = int(bad[0])
            raise PlanInvariantError(
                f"robot {chain.robot!r}: node {k + 1} (task {chain.task[k + 1]}) is planned"
                f" at {chain.planned_start[k + 1]:.6f} s, before node {k} (task"
                f" {chain.task[k]}) that it follows"
            )
    return ranks


def nodes_before(ranks: Sequence[Indices], robot: int, other: int) -> Indices:
    """Return, for each node of ``robot``, how many nodes of ``other`` come before it."""
    return np.searchsorted(ranks[other], ranks[robot]).astype(np.int64)


class FlatGraph(NamedTuple):
    """The nodes of all chains, numbered chain by chain, and the edges into each of them.

    Attributes:
        first: first node of each chain, and the number of nodes, shape (chains + 1,).
        chain: chain of each node, shape (nodes,).
        order: nodes in the total order, shape (nodes,).
        edge_first: edges into node n are ``edge_first[n]`` up to ``edge_first[n + 1]``, shape
            (nodes + 1,).
        source: node that each edge comes from, shape (edges,).
        row: row of each edge in the array that the graph was made from, shape (edges,).
    """

    first: Indices
    chain: Indices
    order: Indices
    edge_first: Indices
    source: Indices
    row: Indices


def flatten_graph(ranks: Sequence[Indices], edges: Indices) -> FlatGraph:
    """Return a graph as flat arrays.

    Args:
        ranks: place of every node in the total order, one array a chain.
        edges: type-2 edges, shape (e, 4).
    """
    first = np.cumsum([0, *(len(r) for r in ranks)], dtype=np.int64)
    rank = np.concatenate([*ranks, np.empty(0, dtype=np.int64)])
    chain = np.repeat(np.arange(len(ranks)), np.diff(first))
    none = np.empty(0, dtype=np.int64)
    order = np.argsort(rank, kind="stable")
    return with_edges(FlatGraph(first, chain, order, none, none, none), edges)


def with_edges(graph: FlatGraph, edges: Indices) -> FlatGraph:
    """Return a graph with the same ordered nodes and other edges, shape (e, 4)."""
    first = graph.first
    target = first[edges[:, 2]] + edges[:, 3]
    row = np.argsort(target, kind="stable")
    into = np.bincount(target, minlength=len(graph.chain))
    return graph._replace(
        edge_first=np.concatenate([[0], np.cumsum(into)]).astype(np.int64),
        source=(first[edges[:, 0]] + edges[:, 1])[row],
        row=row,
    )


@dataclass(frozen=True)
class NodeOrder:
    """Precedence between the nodes of a graph, as vector clocks.

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

        The number of nodes of ``other`` means none.

        Args:
            robot: whose nodes.
            other: the waiting robot.
            nodes: which of them, all by default.
        """
        waits_for = np.ascontiguousarray(self.of(other)[:, robot])
        if nodes is None:
            nodes = np.arange(self.first[robot + 1] - self.first[robot])
        return np.searchsorted(waits_for, nodes, side="left").astype(np.int64)


@kernel
def _clocks(
    graph: FlatGraph,
    keep: npt.NDArray[np.bool_],
    clock: Indices,
    changed: npt.NDArray[np.bool_],
) -> None:
    """Compute vector clocks; ``keep`` becomes False for edges that other paths imply.

    Args:
        graph: the graph.
        keep: of each edge, in the order of the graph.
        clock: of each node; those of nodes that nothing changed for are right already.
        changed: nodes with other edges into them than ``clock`` was made from. Becomes True
            where a clock is another one.
    """
    first, source = graph.first, graph.source
    robots = len(first) - 1
    mine = np.empty(robots, dtype=np.int64)
    for n in graph.order:
        own = graph.chain[n]
        again = changed[n] or (n > first[own] and changed[n - 1])
        for e in range(graph.edge_first[n], graph.edge_first[n + 1]):
            again = again or changed[source[e]]
        if not again:
            continue
        for k in range(robots):
            mine[k] = -1
        if n > first[own]:
            for k in range(robots):
                mine[k] = clock[n - 1, k]
            mine[own] = n - 1 - first[own]
        lo, hi = graph.edge_first[n], graph.edge_first[n + 1]
        for e in range(lo, hi):
            r = graph.chain[source[e]]
            u = source[e] - first[r]
            if mine[r] >= u:
                keep[e] = False
                continue
            for other in range(lo, hi):
                if other == e:
                    continue
                if graph.chain[source[other]] == r:
                    implied = source[other] > source[e] or (
                        source[other] == source[e] and other < e
                    )
                else:
                    implied = clock[source[other], r] >= u
                if implied:
                    keep[e] = False
                    break
        for e in range(lo, hi):
            r = graph.chain[source[e]]
            theirs = clock[source[e]]
            for k in range(robots):
                mine[k] = max(mine[k], theirs[k])
            mine[r] = max(mine[r], source[e] - first[r])
        changed[n] = False
        for k in range(robots):
            if clock[n, k] != mine[k]:
                clock[n, k] = mine[k]
                changed[n] = True


def transitive_reduction(
    ranks: Sequence[Indices], edges: Indices
) -> tuple[NodeOrder, npt.NDArray[np.bool_]]:
    """Return the order that edges impose, and which of them are redundant.

    Args:
        ranks: place of every node in the total order, one array a robot, see ``planned_ranks``.
        edges: type-2 edges, shape (e, 4).

    Returns:
        The order, and True for the edges of the transitive reduction, shape (e,). Of equal
        edges the first one stays.

    Raises:
        PlanInvariantError: an edge goes against the total order.
    """
    graph = flatten_graph(ranks, edges)
    place = np.argsort(graph.order)
    target = np.repeat(np.arange(len(place)), np.diff(graph.edge_first))
    against = graph.row[place[graph.source] >= place[target]]
    if len(against):
        r, u, s, v = edges[against.min()]
        raise PlanInvariantError(
            f"the edge from node {u} of robot {r} to node {v} of robot {s} goes against"
            " the planned order"
        )
    nodes = len(graph.chain)
    clock = np.full((nodes, len(ranks)), -1)
    return update_reduction(
        graph, NodeOrder(graph.first, clock), np.ones(nodes, dtype=np.bool_)
    )


def update_reduction(
    graph: FlatGraph, before: NodeOrder, changed: npt.NDArray[np.bool_]
) -> tuple[NodeOrder, npt.NDArray[np.bool_]]:
    """Return order and reduction, see ``transitive_reduction``, after changes of some edges.

    Args:
        graph: with its edges, which follow the total order.
        before: order of the same nodes with the edges before, reduced.
        changed: nodes that have other edges into them now, shape (all nodes,).
    """
    clock, changed = before.clock.copy(), changed.copy()
    kept = np.ones(len(graph.row), dtype=np.bool_)
    _clocks(graph, kept, clock, changed)
    keep = np.empty(len(kept), dtype=np.bool_)
    keep[graph.row] = kept
    return NodeOrder(graph.first, clock), keep
