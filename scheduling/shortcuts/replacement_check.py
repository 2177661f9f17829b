"""May some nodes be replaced by others, and in what order do those come with everyone else's?

New nodes are checked against every node of another robot that is not ordered with all of them
already, against robots that stand meanwhile and objects at rest, and, by the scene checker,
against what never moves. A node of another robot that comes before the replaced run in the
total order goes before each new node that it conflicts with, a later one after it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from planning.transforms import Indices
from scheduling.conflicts.allowed_contacts import ContactTable, EntityNumbers
from scheduling.conflicts.conflict_search import HullChecker, search_conflicts
from scheduling.conflicts.kept_occupancies import Pieces
from scheduling.conflicts.object_spans import ObjectSpan, Rest, while_at_rest
from scheduling.conflicts.occupancy import Occupancy, hold_occupancy, rest_occupancy
from scheduling.graph.reduction import NodeOrder
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph


@dataclass(frozen=True)
class Surroundings:
    """A graph and what is derived from it.

    Attributes:
        tpg: the graph.
        ranks: place of every node in the total order.
        order: what precedes what.
        objects: what every robot carries when.
        rests: where objects are at rest between nodes.
        pieces: occupancies of the chains.
        entities: numbers of the entities.
        table: allowed contacts and clearances.
    """

    tpg: TemporalPlanGraph
    ranks: Sequence[Indices]
    order: NodeOrder
    objects: Sequence[ObjectSpan]
    rests: Sequence[Rest]
    pieces: Pieces
    entities: EntityNumbers
    table: ContactTable


def order_against(
    around: Surroundings, chain: int, first: int, last: int, new: Occupancy, count: int
) -> list[tuple[int, int, int, int]]:
    """Return the edges that new nodes need.

    Args:
        around: the graph.
        chain: whose nodes ``first`` to ``last`` are to be replaced.
        first, last: those nodes.
        new: what the new nodes occupy, numbered from 0.
        count: how many there are.

    Returns:
        Edges (robot, node, robot, node) with the new nodes numbered from ``first``; nodes of
        other robots as they are.
    """
    edges: list[tuple[int, int, int, int]] = []
    for other in range(len(around.tpg.chains)):
        if other != chain:
            edges += _against_robot(around, chain, first, last, new, count, other)
    return edges


def _against_robot(
    around: Surroundings,
    chain: int,
    first: int,
    last: int,
    new: Occupancy,
    count: int,
    other: int,
) -> list[tuple[int, int, int, int]]:
    done = int(around.order.of(chain)[first - 1, other])
    after = int(around.order.first_after(chain, other, np.array([last]))[0])
    turn = int(
        np.searchsorted(around.ranks[other], around.ranks[chain][last], side="left")
    )
    turn = min(max(turn, done + 1), after)
    checker = HullChecker(around.table)
    edges = []
    tpg, objects = around.tpg, around.objects
    for at, piece in around.pieces.between(tpg, other, done + 1, turn, objects):
        size = int(piece.sequence.node[-1]) + 1
        floor = np.full(count, done - at)
        limit = np.full(count, min(turn - at, size))
        for v, u in search_conflicts(new, piece, floor, limit, around.table, checker):
            edges.append((other, at + u, chain, first + v))
    for at, piece in around.pieces.between(tpg, other, turn, after, objects):
        size = int(piece.sequence.node[-1]) + 1
        floor = np.full(size, -1)
        limit = np.where(
            (np.arange(size) + at >= turn) & (np.arange(size) + at < after), count, 0
        )
        # The window ends the piece: beyond it nothing is asked, and limits may not fall.
        stop = int(np.searchsorted(np.arange(size) + at, after))
        limit[stop:] = limit[stop - 1] if stop else 0
        floor[stop:] = count
        for w, x in search_conflicts(piece, new, floor, limit, around.table, checker):
            edges.append((chain, first + x, other, at + w))
    return edges


def holds_stay_clear(
    around: Surroundings, chain: int, first: int, new: Occupancy, count: int
) -> bool:
    """Tell whether new nodes and robots that stand keep apart, in the graph that has them.

    New nodes may now fall into a stand of another robot, or meet what it has been given while it
    stands, and another robot's nodes may fall into the stand before the first new node. Every
    other stand is as it was.

    Args:
        around: the graph with the new nodes; pieces of their chain are not looked at.
        chain, first: where the new nodes are.
        new: what they occupy, numbered from 0.
        count: how many there are.
    """
    order, tpg, table = around.order, around.tpg, around.table
    checker = HullChecker(table)
    for other in range(len(tpg.chains)):
        if other == chain:
            continue
        before = order.of(chain)[first : first + count, other]
        after = order.first_after(chain, other, np.arange(first, first + count))
        stands = before + 1 == after
        for hold in np.unique(after[stands]).tolist():
            where = np.flatnonzero(stands & (after == hold))
            standing = hold_occupancy(
                tpg, other, np.array([hold]), around.objects, around.entities
            )
            limit = np.zeros(count, dtype=np.int64)
            limit[where[0] :] = 1
            floor = np.full(count, -1)
            if _any_conflict(new, standing, floor, limit, table, checker):
                return False
        waits_for = order.of(other)[:, chain]
        lo = int(np.searchsorted(waits_for, first - 1, side="left"))
        hi = min(
            int(np.searchsorted(waits_for, first - 1, side="right")),
            int(order.of(chain)[first, other]) + 1,
        )
        if lo >= hi:
            continue
        standing = hold_occupancy(
            tpg, chain, np.array([first]), around.objects, around.entities
        )
        for at, piece in around.pieces.between(tpg, other, lo, hi, around.objects):
            size = int(piece.sequence.node[-1]) + 1
            nodes = np.arange(size) + at
            limit = (nodes >= lo).astype(np.int64)
            floor = np.where(nodes >= hi, 1, -1)
            if _any_conflict(piece, standing, floor, limit, table, checker):
                return False
    return _gifts_stay_clear(around, chain, first, new, count)


def _gifts_stay_clear(
    around: Surroundings, chain: int, first: int, new: Occupancy, count: int
) -> bool:
    """Tell whether new nodes keep clear of objects handed to robots that stand.

    Such an object is in the robot's hand only from its next node on: its stand does not show it.
    """
    tpg, nodes = around.tpg, len(around.tpg.chains[chain])
    for rest in around.rests:
        if rest.holder is None:
            continue
        floor, limit = while_at_rest(around.order, rest, chain, nodes)
        floor, limit = max(floor - first, -1), min(limit - first, count)
        if floor + 1 >= limit:
            continue
        there = rest_occupancy(tpg, rest, around.entities)
        window = np.full(1, floor), np.full(1, limit)
        if _any_conflict(there, new, *window, around.table, HullChecker(around.table)):
            return False
    return True


def _any_conflict(
    a: Occupancy,
    b: Occupancy,
    floor: Indices,
    limit: Indices,
    table: ContactTable,
    checker: HullChecker,
) -> bool:
    found = search_conflicts(a, b, floor, limit, table, checker)
    return next(found, None) is not None
