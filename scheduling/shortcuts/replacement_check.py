"""Conflicts of replacement nodes with other robots' nodes, and the edges they require.

New nodes are checked against every node of another robot that is not ordered with all of them
already, against robots that stand meanwhile and objects at rest; ``static_scene`` knows what never
moves. Of two that conflict, the one that is earlier in the total order goes first; a new node has
the place of the one that it replaces.
"""

from __future__ import annotations

import numpy as np

from planning.transforms import Indices
from scheduling.conflicts.derived_tpg import (
    DerivedTpg,
    Occupant,
    occupant_of_holds,
    occupant_of_rest,
)
from scheduling.conflicts.object_spans import nodes_meeting_rest
from scheduling.shortcuts.graph_pieces import GraphPieces
from scheduling.shortcuts.rewiring import Edge, Swap


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
            self.outside += self._go_first(other, done + 1, low * ones)
            self.outside += self._wait(other, high * ones, after)

    @property
    def choice(self) -> bool:
        """True if the position of the new nodes in the total order matters."""
        return any(low < high for low, high in self._between.values())

    def edges(self, ordered: DerivedTpg) -> list[Edge]:
        """Return the type-2 edges that the new nodes require.

        Args:
            ordered: the graph, with the nodes that are to be replaced where the new ones are to
                stand in the total order.
        """
        swap, found = self._swap, list(self.outside)
        own = ordered.ranks[swap.chain][swap.first : swap.last + 1]
        for other, (low, high) in self._between.items():
            if low < high:
                # Of the other's nodes, how many come before each new node.
                turn = np.clip(np.searchsorted(ordered.ranks[other], own), low, high)
                found += self._go_first(other, low, turn)
                found += self._wait(other, turn, high)
        return found

    def _go_first(self, other: int, first: int, turn: Indices) -> list[Edge]:
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
                edges.append((swap.chain, swap.first + x, other, at + w))
        return edges


def are_standing_robots_clear(
    graph: DerivedTpg, pieces: GraphPieces, swap: Swap, new: Occupant
) -> bool:
    """Tell whether new nodes and standing robots are clear of each other, in the new graph.

    New nodes may now fall into a stand of another robot, or meet what it has been given while it
    stands, and another robot's nodes may fall into the stands before and between the new nodes.
    Every other stand is as it was.

    Args:
        graph: with the new nodes.
        pieces: occupancies of its chains; those of the new nodes' chain are not looked at.
        swap: the new nodes.
        new: the same, numbered from 0.
    """
    return all(
        _clear_of_stands(graph, pieces, swap, new, other)
        and _stand_clear(graph, pieces, swap, other)
        for other in range(len(graph.tpg.chains))
        if other != swap.chain
    ) and _are_received_objects_clear(graph, pieces, swap, new)


def _clear_of_stands(
    graph: DerivedTpg, pieces: GraphPieces, swap: Swap, new: Occupant, other: int
) -> bool:
    """Tell whether new nodes are clear of another robot wherever it stands meanwhile."""
    nodes = np.arange(swap.first, swap.first + swap.count)
    before = graph.order.of(swap.chain)[nodes, other]
    after = graph.order.first_after(swap.chain, other, nodes)
    stands = before + 1 == after
    for hold in np.unique(after[stands]).tolist():
        from_here = np.flatnonzero(stands & (after == hold))[0]
        limit = (np.arange(swap.count) >= from_here).astype(np.int64)
        floor = np.full(swap.count, -1)
        standing = occupant_of_holds(graph, other, np.array([hold]))
        if not pieces.conflicts.are_clear(graph, new, standing, (floor, limit)):
            return False
    return True


def _stand_clear(
    graph: DerivedTpg, pieces: GraphPieces, swap: Swap, other: int
) -> bool:
    """Tell whether another robot is clear of the stands before each of the new nodes."""
    chain = swap.chain
    holds = np.arange(swap.first, swap.first + swap.count)
    waits_for = np.ascontiguousarray(graph.order.of(other)[:, chain])
    first = np.searchsorted(waits_for, holds - 1, side="left")
    stop = np.minimum(
        np.searchsorted(waits_for, holds - 1, side="right"),
        graph.order.of(chain)[holds, other] + 1,
    )
    met = first < stop
    if not np.any(met):
        return True
    first, stop = first[met], stop[met]
    standing = occupant_of_holds(graph, chain, holds[met])
    return all(
        pieces.conflicts.are_clear(graph, standing, piece, (first - 1 - at, stop - at))
        for at, piece in pieces.between(graph, other, int(first[0]), int(stop[-1]))
    )


def _are_received_objects_clear(
    graph: DerivedTpg, pieces: GraphPieces, swap: Swap, new: Occupant
) -> bool:
    """Tell whether new nodes are clear of objects handed to standing robots.

    Such an object is in the robot's hand only from its next node on: its stand does not show it.
    """
    nodes = len(graph.tpg.chains[swap.chain])
    for rest in graph.history.rests:
        if rest.holder is None:
            continue
        floor, limit = nodes_meeting_rest(graph.order, rest, swap.chain, nodes)
        floor, limit = max(floor - swap.first, -1), min(limit - swap.first, swap.count)
        if floor + 1 >= limit:
            continue
        window = np.full(1, floor), np.full(1, limit)
        at_rest = occupant_of_rest(graph, rest)
        if not pieces.conflicts.are_clear(graph, at_rest, new, window):
            return False
    return True
