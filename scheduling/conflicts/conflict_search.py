"""Conflicts between nodes of different robots: capsules propose, convex hulls decide.

For each ordered pair of robots and each node v of the one, the last node u of the other that is
earlier in the total order and conflicts with v must be complete before v starts (APEX-MR,
Algorithm 1). Occupancies are swept, from the configuration before a node to its own, so the edge
starts at that last conflicting node itself: once it is complete its robot stands at the start of
the next node, which is clear of v. With the paper's point occupancies that is its successor rule.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import count

import numpy as np

from planning.geometry.exact import come_close, distance_at
from planning.parallel import side_by_side
from planning.transforms import Indices
from scheduling.conflicts.allowed_contacts import ContactTable
from scheduling.conflicts.close_bodies import Descent, start_descent
from scheduling.conflicts.occupancy import Occupancy
from scheduling.conflicts.staircase import next_proposal, raise_floor
from scheduling.graph.reduction import NodeOrder
from scheduling.graph.total_order import nodes_before

_MOST_HITS = 32768


def hulls_conflict(
    a: Occupancy, s: int, b: Occupancy, t: int, descent: Descent, proposed: slice
) -> bool:
    """Decide by the distance of convex hulls over both whole motions whether segments conflict.

    Args:
        a, s: an occupancy and a segment of it.
        b, t: another robot's occupancy and a segment of it.
        descent: what proposed their bodies.
        proposed: the pairs of bodies.
    """
    table, robots = descent.table, descent.table.robots
    a_from, a_to = a.hulls.q_a[s], a.hulls.q_b[s]
    b_from, b_to = b.hulls.q_a[t], b.hulls.q_b[t]
    pairs, where = descent.pairs[proposed].tolist(), descent.where[proposed].tolist()
    for (i, j), (x, y) in zip(pairs, where, strict=True):
        one, other = a.sequence.entity[s, i], b.sequence.entity[t, j]
        limit = table.clearance[0 if one < robots and other < robots else 1]
        limit = float(limit) - descent.slack
        solid_a = a.solids[a.hulls.solid[s, i]]
        solid_b = b.solids[b.hulls.solid[t, j]]
        if not np.isnan(x):
            q_a, q_b = a_from + x * (a_to - a_from), b_from + y * (b_to - b_from)
            if distance_at(solid_a, q_a, solid_b, q_b) < limit:
                return True
        if come_close(solid_a, a_from, a_to, solid_b, b_from, b_to, limit):
            return True
    return False


def search_conflicts(
    a: Occupancy,
    b: Occupancy,
    floor: Indices,
    limit: Indices,
    table: ContactTable,
    slack: float = 0.0,
) -> Iterator[tuple[int, int]]:
    """Yield conflicts (v, u) of two occupancies until those yielded imply all others.

    (v, u) implies (w, x) when w is not before v and x is not after u.

    Args:
        a: occupancy of the nodes v.
        b: occupancy of the nodes u.
        floor: last u implied for each v already, never falling; raised here.
        limit: first u that is not asked for, for each v, never falling.
        table: allowed contacts and clearances.
        slack: taken off the clearances [m].
    """
    descent = start_descent(a.sequence, b.sequence, table, floor, limit, slack)
    depth = 1
    # Who asks for the first conflict alone does not have to wait for more.
    hits = np.empty((1, 2), dtype=np.int64)
    while depth > 0:
        depth, s, t, first, bodies, found = next_proposal(descent, depth, hits)
        yield from map(tuple, hits[:found].tolist())
        if found == len(hits):
            hits = np.empty((min(8 * found, _MOST_HITS), 2), dtype=np.int64)
        if bodies == 0:
            continue
        if hulls_conflict(a, s, b, t, descent, slice(first, first + bodies)):
            v, u = int(a.sequence.node[s]), int(b.sequence.node[t])
            raise_floor(floor, v, u)
            yield v, u


def find_motion_edges(
    occupancies: Sequence[Occupancy],
    ranks: Sequence[Indices],
    order: NodeOrder,
    table: ContactTable,
    progress: Callable[[int, int], None] | None = None,
) -> Indices:
    """Return the type-2 edges that motion conflicts ask for, not reduced, shape (e, 4).

    Args:
        occupancies: one a chain.
        ranks: place of every node in the total order.
        order: what task dependencies imply; not searched again.
        table: allowed contacts and clearances.
        progress: called after each ordered pair of robots with pairs done and in all, by the
            thread that searched it.
    """
    robots = range(len(occupancies))
    todo = [(i, k) for i in robots for k in robots if i != k]
    done = count()

    def search(pair: tuple[int, int]) -> list[tuple[int, int, int, int]]:
        i, k = pair
        floor = np.ascontiguousarray(order.last_before(i, k))
        limit = nodes_before(ranks, i, k)
        found = search_conflicts(occupancies[i], occupancies[k], floor, limit, table)
        edges = [(k, u, i, v) for v, u in found]
        if progress is not None:
            progress(next(done) + 1, len(todo))
        return edges

    edges = {edge for found in side_by_side(search, todo) for edge in found}
    return np.array(sorted(edges), dtype=np.int64).reshape(-1, 4)
