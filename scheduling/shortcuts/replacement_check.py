"""Conflicts of replacement nodes with nodes of other robots, and the edges that these conflicts require.

A replacement node is a new piece of motion in place of an existing node. It is checked against all nodes of other
robots whose order with it is not yet fixed. Of two conflicting nodes, the one earlier in the total order goes first.
A new node takes the position of the node that it replaces. ``stand_check`` checks robots at rest, and
``static_scene`` checks static obstacles.
"""

from __future__ import annotations

import numpy as np

from planning.transforms import Indices
from scheduling.conflicts.derived_tpg import DerivedTpg, Occupant
from scheduling.shortcuts.graph_pieces import GraphPieces
from scheduling.shortcuts.rewiring import Edge, Swap


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
    """

    def __init__(
        self, graph: DerivedTpg, pieces: GraphPieces, swap: Swap, new: Occupant
    ) -> None:
        self._graph, self._pieces, self._swap, self._new = graph, pieces, swap, new
        chain, first, last = swap.chain, swap.first, swap.last
        self._between: dict[int, tuple[int, int]] = {}
        self.outside: list[Edge] = []
        ends = graph.ranks[chain][[first, last]]
        for other in range(len(graph.tpg.chains)):
            if other == chain:
                continue
            done = int(graph.order.of(chain)[first - 1, other])
            after = int(graph.order.first_after(chain, other, np.array([last]))[0])
            turns = np.searchsorted(graph.ranks[other], ends)
            low, high = np.clip(turns, done + 1, after).tolist()
            self._between[other] = low, high
            ones = np.ones(swap.count, dtype=np.int64)
            self.outside += self._edges_to_new_nodes(other, done + 1, low * ones)
            self.outside += self._edges_from_new_nodes(other, high * ones, after)

    @property
    def choice(self) -> bool:
        """True if the position of the new nodes in the total order matters."""
        return any(low < high for low, high in self._between.values())

    def edges(self, ordered: DerivedTpg) -> list[Edge]:
        """Return the type-2 edges that the new nodes require.

        Args:
            ordered: the graph, with the nodes to be replaced at the places of the new ones in the
                total order.
        """
        swap, found = self._swap, list(self.outside)
        own = ordered.ranks[swap.chain][swap.first : swap.last + 1]
        for other, (low, high) in self._between.items():
            if low < high:
                # Number of the other robot's nodes before each new node.
                turn = np.clip(np.searchsorted(ordered.ranks[other], own), low, high)
                found += self._edges_to_new_nodes(other, low, turn)
                found += self._edges_from_new_nodes(other, turn, high)
        return found

    def _edges_to_new_nodes(self, other: int, first: int, turn: Indices) -> list[Edge]:
        """Return edges from nodes of another robot, from ``first`` on, to the new nodes, by rank."""
        edges, chain, at_least = [], self._swap.chain, self._swap.first
        search = self._pieces.conflicts.search
        between = self._pieces.between(self._graph, other, first, int(turn[-1]))
        for at, piece in between:
            floor = np.full(self._swap.count, first - 1 - at)
            limit = np.minimum(turn - at, piece.nodes)
            for v, u in search(self._graph, self._new, piece, (floor, limit)):
                edges.append((other, at + u, chain, at_least + v))
        return edges

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
                edges.append((swap.chain, swap.first + x, other, at + w))
        return edges
