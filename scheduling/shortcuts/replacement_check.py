"""Conflicts of replacement nodes with nodes of other robots, and the edges that these conflicts require.

A replacement node is a new piece of motion in place of an existing node. It is checked against all nodes of other
robots whose order with it is not yet fixed. Of two conflicting nodes, the one earlier in the total order goes first.
A new node takes the position of the node that it replaces. ``stand_check`` checks robots at rest, and
``static_scene`` checks static obstacles.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from planning.transforms import Indices
from scheduling.conflicts.derived_tpg import DerivedTpg, Occupant
from scheduling.shortcuts.edge_bound import EdgeBound
from scheduling.shortcuts.graph_pieces import GraphPieces
from scheduling.shortcuts.rewiring import Edge, Swap


class _ExcludedEdgeError(Exception):
    """Ends a search at an edge that a bound excludes."""


class ReplacementConflicts:
    """Conflicts of new nodes with the nodes of other robots that are not ordered with them.

    Nodes before the first replaced node or after the last one in the total order go before or after all
    new nodes at any place of these; their conflicts are searched once. Edges (robot, node,
    robot, node) have the new nodes numbered from ``swap.first``.

    Args:
        graph: the graph.
        pieces: occupancies of its chains.
        swap: the nodes that are to be replaced.
        new: the new nodes, numbered from 0.
        bound: excludes edges; a search ends at the first of these. None to find all edges.
    """

    def __init__(
        self,
        graph: DerivedTpg,
        pieces: GraphPieces,
        swap: Swap,
        new: Occupant,
        bound: EdgeBound | None = None,
    ) -> None:
        self._graph, self._pieces, self._swap, self._new = graph, pieces, swap, new
        self._bound = bound
        chain, first, last = swap.chain, swap.first, swap.last
        self._between: dict[int, tuple[int, int]] = {}
        self._unordered: dict[int, tuple[int, int]] = {}
        ends = graph.ranks[chain][[first, last]]
        for other in range(len(graph.tpg.chains)):
            if other == chain:
                continue
            done = int(graph.order.of(chain)[first - 1, other])
            after = int(graph.order.first_after(chain, other, np.array([last]))[0])
            turns = np.searchsorted(graph.ranks[other], ends)
            low, high = np.clip(turns, done + 1, after).tolist()
            self._between[other] = low, high
            self._unordered[other] = done + 1, after

    @property
    def choice(self) -> bool:
        """True if the position of the new nodes in the total order matters."""
        return any(low < high for low, high in self._between.values())

    def edges(self, ordered: DerivedTpg) -> list[Edge] | None:
        """Return the type-2 edges that the new nodes require, None where one of them is excluded.

        Args:
            ordered: the graph, with the nodes to be replaced at the places of the new ones in the
                total order.
        """
        swap, found = self._swap, list[Edge]()
        own = ordered.ranks[swap.chain][swap.first : swap.last + 1]
        try:
            for other, (low, high) in self._between.items():
                if low < high:
                    # Number of the other robot's nodes before each new node.
                    turn = np.clip(
                        np.searchsorted(ordered.ranks[other], own), low, high
                    )
                    found += self._edges_to_new_nodes(other, low, turn)
                    found += self._edges_from_new_nodes(other, turn, high)
            return [*self._outside, *found]
        except _ExcludedEdgeError:
            return None

    @cached_property
    def _outside(self) -> list[Edge]:
        """The edges that are the same at any place of the new nodes in the total order."""
        found, ones = list[Edge](), np.ones(self._swap.count, dtype=np.int64)
        for other, (first, stop) in self._unordered.items():
            low, high = self._between[other]
            found += self._edges_to_new_nodes(other, first, low * ones)
            found += self._edges_from_new_nodes(other, high * ones, stop)
        return found

    def _allowed(self, edge: Edge) -> Edge:
        """Return an edge.

        Raises:
            _ExcludedEdgeError: it is excluded.
        """
        if self._bound is not None and self._bound.excludes(edge):
            raise _ExcludedEdgeError
        return edge

    def _edges_to_new_nodes(self, other: int, first: int, turn: Indices) -> list[Edge]:
        """Return edges from nodes of another robot, from ``first`` on, to the new nodes, by rank."""
        found, chain, at_least = list[list[Edge]](), self._swap.chain, self._swap.first
        search = self._pieces.conflicts.search
        between = self._pieces.between(self._graph, other, first, int(turn[-1]))
        # The later a node of the other robot, the sooner its edges are excluded.
        for at, piece in reversed(list(between)):
            floor = np.full(self._swap.count, first - 1 - at)
            limit = np.minimum(turn - at, piece.nodes)
            conflicts = search(self._graph, self._new, piece, (floor, limit))
            edges = ((other, at + u, chain, at_least + v) for v, u in conflicts)
            found.append([self._allowed(edge) for edge in edges])
        return [edge for edges in reversed(found) for edge in edges]

    def _edges_from_new_nodes(self, other: int, turn: Indices, stop: int) -> list[Edge]:
        """Return edges from the new nodes to nodes of another robot up to ``stop``, by rank."""
        edges, swap, search = [], self._swap, self._pieces.conflicts.search
        for at, piece in self._pieces.between(self._graph, other, int(turn[0]), stop):
            nodes = at + np.arange(piece.nodes)
            inside = nodes < stop
            asked = np.searchsorted(turn, nodes, side="right")
            floor = np.where(inside, -1, swap.count)
            limit = np.where(inside, asked, swap.count)
            for w, x in search(self._graph, piece, self._new, (floor, limit)):
                edge = swap.chain, swap.first + x, other, at + w
                edges.append(self._allowed(edge))
        return edges
