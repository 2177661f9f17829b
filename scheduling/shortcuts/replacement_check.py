"""Conflicts of replacement nodes with other robots' nodes, and the edges they require.

New nodes are checked against every node of another robot that is not ordered with all of them
already; ``stand_check`` considers robots that stand meanwhile, ``static_scene`` what never moves. Of two that conflict, the one that is earlier in the total order goes first; a new node has
the place of the one that it replaces.
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


class Rivals:
    """Other robots' nodes that are unordered against some new nodes, and their conflicts.

    Those that come before the first replaced node, or after the last one, go before or after all
    new nodes wherever these stand in the total order: they are searched once. Edges (robot, node,
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
            ordered: the graph, with the nodes that are to be replaced where the new ones are to
                stand in the total order.
        """
        swap, found = self._swap, list[Edge]()
        own = ordered.ranks[swap.chain][swap.first : swap.last + 1]
        try:
            for other, (low, high) in self._between.items():
                if low < high:
                    # Of the other's nodes, how many come before each new node.
                    turn = np.clip(
                        np.searchsorted(ordered.ranks[other], own), low, high
                    )
                    found += self._go_first(other, low, turn)
                    found += self._wait(other, turn, high)
            return [*self._outside, *found]
        except _ExcludedEdgeError:
            return None

    @cached_property
    def _outside(self) -> list[Edge]:
        """The edges that are the same wherever the new nodes stand in the total order."""
        found, ones = list[Edge](), np.ones(self._swap.count, dtype=np.int64)
        for other, (first, stop) in self._unordered.items():
            low, high = self._between[other]
            found += self._go_first(other, first, low * ones)
            found += self._wait(other, high * ones, stop)
        return found

    def _allowed(self, edge: Edge) -> Edge:
        """Return an edge.

        Raises:
            _ExcludedEdgeError: it is excluded.
        """
        if self._bound is not None and self._bound.excludes(edge):
            raise _ExcludedEdgeError
        return edge

    def _go_first(self, other: int, first: int, turn: Indices) -> list[Edge]:
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

    def _wait(self, other: int, turn: Indices, stop: int) -> list[Edge]:
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
