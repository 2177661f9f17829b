"""Collision checks between replacement nodes and robots at rest.

New nodes are checked against robots that are at rest at the same time, including the objects that they hold.
Other robots are checked against the positions in which the robot waits before its new nodes.
"""

from __future__ import annotations

import numpy as np

from scheduling.conflicts.derived_tpg import (
    DerivedTpg,
    Occupant,
    occupant_of_holds,
    occupant_of_rest,
)
from scheduling.conflicts.object_spans import nodes_meeting_rest
from scheduling.shortcuts.graph_pieces import GraphPieces
from scheduling.shortcuts.rewiring import Swap


def are_standing_robots_clear(
    graph: DerivedTpg, pieces: GraphPieces, swap: Swap, new: Occupant
) -> bool:
    """Tell whether new nodes and robots at rest keep their clearance from each other, in the new graph.

    New nodes may now be executed during a standstill of another robot, or meet an object handed to it
    then, and another robot's nodes may be executed during the standstills before and between the new
    nodes. All other standstills are unchanged.

    Args:
        graph: with the new nodes.
        pieces: occupancies of its chains; those of the new nodes' chain are not checked.
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
    """Tell whether another robot is clear of the standstills before each of the new nodes."""
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

    The robot holds such an object only from its next node on: the occupancy of its standstill is without it.
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
