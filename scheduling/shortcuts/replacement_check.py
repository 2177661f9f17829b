"""Conflicts of replacement nodes with other robots' nodes, and the edges they require.

New nodes are checked against every node of another robot that is not ordered with all of them
already, against robots that stand meanwhile and objects at rest, and, by the scene checker,
against what never moves. A node of another robot that comes before the replaced run in the
total order goes before each new node that it conflicts with, a later one after it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from planning.cell.workcell import Attachment, Workcell, WorldState
from planning.geometry.scene_checker import SceneChecker
from planning.motion.sequential import MARGIN
from planning.transforms import Array, Indices
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.conflicts.object_spans import Rest, while_at_rest
from scheduling.conflicts.occupancy import Occupancy
from scheduling.graph.reduction import NodeOrder
from scheduling.shortcuts.rewiring import Edge, Swap


def order_against(
    graph: DerivedTpg, pieces: Pieces, swap: Swap, new: Occupancy
) -> list[Edge]:
    """Return the type-2 edges that new nodes require.

    Args:
        graph: the graph.
        pieces: occupancies of its chains.
        swap: the nodes that are to be replaced.
        new: what the new nodes occupy, numbered from 0.

    Returns:
        Edges (robot, node, robot, node) with the new nodes numbered from ``swap.first``; nodes
        of other robots as they are.
    """
    edges: list[Edge] = []
    for other in range(len(graph.tpg.chains)):
        if other != swap.chain:
            edges += _against_robot(graph, pieces, swap, new, other)
    return edges


def _against_robot(
    graph: DerivedTpg, pieces: Pieces, swap: Swap, new: Occupancy, other: int
) -> list[Edge]:
    chain, first, last = swap.chain, swap.first, swap.last
    done = int(graph.order.of(chain)[first - 1, other])
    after = int(graph.order.first_after(chain, other, np.array([last]))[0])
    turn = int(np.searchsorted(graph.ranks[other], graph.ranks[chain][last]))
    turn = min(max(turn, done + 1), after)
    edges = []
    for at, piece in pieces.between(graph, other, done + 1, turn):
        floor = np.full(swap.count, done - at)
        limit = np.full(swap.count, min(turn - at, piece.nodes))
        for v, u in graph.conflicts(new, piece, floor, limit):
            edges.append((other, at + u, chain, first + v))
    for at, piece in pieces.between(graph, other, turn, after):
        window = _nodes_within(at, piece, turn, after, swap.count)
        for w, x in graph.conflicts(piece, new, *window):
            edges.append((chain, first + x, other, at + w))
    return edges


def _nodes_within(
    at: int, piece: Occupancy, first: int, stop: int, count: int
) -> tuple[Indices, Indices]:
    """Return the window of a search in which nodes of a piece ask for all ``count`` others.

    Args:
        at: first node of the piece.
        piece: its occupancy.
        first, stop: only nodes ``range(first, stop)`` ask.
        count: number of others.
    """
    nodes = at + np.arange(piece.nodes)
    return np.where(nodes >= stop, count, -1), np.where(nodes >= first, count, 0)


def stands_stay_clear(
    graph: DerivedTpg, pieces: Pieces, swap: Swap, new: Occupancy
) -> bool:
    """Tell whether new nodes and robots that stand keep apart, in the graph that has them.

    New nodes may now fall into a stand of another robot, or meet what it has been given while it
    stands, and another robot's nodes may fall into the stand before the first new node. Every
    other stand is as it was.

    Args:
        graph: with the new nodes.
        pieces: occupancies of its chains; those of the new nodes' chain are not looked at.
        swap: the new nodes.
        new: what they occupy, numbered from 0.
    """
    return all(
        _clear_of_stands(graph, swap, new, other)
        and _stand_clear(graph, pieces, swap, other)
        for other in range(len(graph.tpg.chains))
        if other != swap.chain
    ) and _gifts_stay_clear(graph, swap, new)


def _clear_of_stands(graph: DerivedTpg, swap: Swap, new: Occupancy, other: int) -> bool:
    """Tell whether new nodes keep clear of another robot wherever it stands meanwhile."""
    nodes = np.arange(swap.first, swap.first + swap.count)
    before = graph.order.of(swap.chain)[nodes, other]
    after = graph.order.first_after(swap.chain, other, nodes)
    stands = before + 1 == after
    for hold in np.unique(after[stands]).tolist():
        from_here = np.flatnonzero(stands & (after == hold))[0]
        limit = (np.arange(swap.count) >= from_here).astype(np.int64)
        floor = np.full(swap.count, -1)
        standing = graph.holds(other, np.array([hold]))
        if graph.first_conflict(new, standing, floor, limit) is not None:
            return False
    return True


def _stand_clear(graph: DerivedTpg, pieces: Pieces, swap: Swap, other: int) -> bool:
    """Tell whether another robot keeps clear of the stand before the first new node."""
    chain, first = swap.chain, swap.first
    waits_for = graph.order.of(other)[:, chain]
    lo = int(np.searchsorted(waits_for, first - 1, side="left"))
    hi = min(
        int(np.searchsorted(waits_for, first - 1, side="right")),
        int(graph.order.of(chain)[first, other]) + 1,
    )
    if lo >= hi:
        return True
    standing = graph.holds(chain, np.array([first]))
    return all(
        graph.first_conflict(piece, standing, *_nodes_within(at, piece, lo, hi, 1))
        is None
        for at, piece in pieces.between(graph, other, lo, hi)
    )


def _gifts_stay_clear(graph: DerivedTpg, swap: Swap, new: Occupancy) -> bool:
    """Tell whether new nodes keep clear of objects handed to robots that stand.

    Such an object is in the robot's hand only from its next node on: its stand does not show it.
    """
    nodes = len(graph.tpg.chains[swap.chain])
    for rest in graph.history.rests:
        if rest.holder is None:
            continue
        floor, limit = while_at_rest(graph.order, rest, swap.chain, nodes)
        floor, limit = max(floor - swap.first, -1), min(limit - swap.first, swap.count)
        if floor + 1 >= limit:
            continue
        window = np.full(1, floor), np.full(1, limit)
        if graph.first_conflict(graph.rest(rest), new, *window) is not None:
            return False
    return True


_LONGEST = 128
"""Nodes in a piece."""


class Pieces:
    """All chains of a graph, cut so that every run that may be shortened is pieces of its own.

    Args:
        lengths: number of nodes of each chain.
        cuts: per chain, nodes at which a piece has to start.
    """

    def __init__(self, lengths: Sequence[int], cuts: Sequence[Sequence[int]]) -> None:
        self._sizes: list[list[int]] = []
        self._built: list[list[Occupancy | None]] = []
        for length, wanted in zip(lengths, cuts, strict=True):
            sizes = []
            for lo, hi in pairwise(sorted({0, *wanted, length})):
                parts = -(-(hi - lo) // _LONGEST)
                marks = np.linspace(lo, hi, parts + 1).astype(int)
                sizes += np.diff(marks).tolist()
            self._sizes.append(sizes)
            self._built.append([None] * len(sizes))

    def between(
        self, graph: DerivedTpg, chain: int, first: int, stop: int
    ) -> Iterator[tuple[int, Occupancy]]:
        """Yield the first node and the occupancy of every piece with nodes in a range.

        Args:
            graph: as it is now.
            chain: the chain.
            first, stop: its nodes ``range(first, stop)``.
        """
        starts = self._starts(chain)
        lo = int(np.searchsorted(starts, first, side="right")) - 1
        for piece, (at, end) in enumerate(pairwise(starts[lo:].tolist()), lo):
            if at >= stop:
                return
            built = self._built[chain][piece]
            if built is None:
                built = graph.occupancy(chain, at, end)
                self._built[chain][piece] = built
            yield at, built

    def splice(self, swap: Swap) -> None:
        """Forget the pieces around nodes that were replaced."""
        starts = self._starts(swap.chain)
        lo = int(np.searchsorted(starts, swap.first, side="right")) - 1
        hi = int(np.searchsorted(starts, swap.last, side="right"))
        size = int(starts[hi] - starts[lo]) + swap.shift
        self._sizes[swap.chain][lo:hi] = [size]
        self._built[swap.chain][lo:hi] = [None]

    def _starts(self, chain: int) -> Indices:
        return np.cumsum([0, *self._sizes[chain]])


class Scenery:
    """Checks paths that are to take the place of nodes; remembers the scenes."""

    def __init__(self) -> None:
        self._checkers: dict[object, SceneChecker] = {}

    def free(
        self, graph: DerivedTpg, index: int, first: int, last: int, path: Array
    ) -> bool:
        """Tell whether a path is free in place of some nodes.

        Args:
            graph: as it is.
            index: chain of the nodes.
            first, last: the nodes.
            path: polyline, shape (w, n).
        """
        chain = graph.tpg.chains[index]
        present = tuple(
            rest
            for rest in graph.history.rests
            if rest.holder is None
            and _may_lie_there(graph.order, rest, index, first, last)
        )
        tasks = frozenset(chain.task[first : last + 1].tolist())
        # Within the tasks of a run, a robot carries the same.
        key = (index, tasks, frozenset((r.object, r.pose.tobytes()) for r in present))
        checker = self._checkers.get(key)
        if checker is None:
            checker = _checker(graph, index, first, tasks, present)
            self._checkers[key] = checker
        return all(checker.motion_free(a, b) for a, b in pairwise(path))


def _may_lie_there(
    order: NodeOrder, rest: Rest, index: int, first: int, last: int
) -> bool:
    """Tell whether an object may be at rest while nodes are under way."""
    too_late = rest.after is not None and order.precedes(index, last, *rest.after)
    gone = rest.before is not None and (
        rest.before == (index, first - 1)
        or order.precedes(*rest.before, index, first - 1)
    )
    return not (too_late or gone)


def _checker(
    graph: DerivedTpg,
    index: int,
    first: int,
    tasks: frozenset[int],
    present: tuple[Rest, ...],
) -> SceneChecker:
    """Return a checker against all that does not move: no robot that has nodes."""
    tpg = graph.tpg
    robot = tpg.chains[index].robot
    busy = tpg.chain_index
    handled = {handling.object for handling in tpg.handlings}
    attachments = {
        item.name: Attachment(None, item.start)
        for item in tpg.cell.objects
        if item.name not in handled and item.start is not None
    }
    for rest in present:
        attachments[rest.object] = Attachment(None, rest.pose)
    for span in graph.spans[index]:
        if span.carried and span.start <= (first, 0) < span.end:
            attachments[span.object] = Attachment(robot, span.pose)
    robots = tuple(r for r in tpg.cell.robots if r.name == robot or r.name not in busy)
    cell = Workcell(robots, tpg.cell.fixtures, tpg.cell.objects, tpg.cell.clearances)
    state = WorldState({r.name: r.home for r in robots}, attachments)
    allowed = frozenset(
        frozenset((c.first, c.second)) for c in tpg.allowed if tasks <= c.tasks
    )
    return SceneChecker(cell, robot, state, allowed, margin=MARGIN)
