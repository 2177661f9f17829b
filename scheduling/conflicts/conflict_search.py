"""Search for conflicts of two occupancies: capsules propose, convex hulls decide."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from planning.geometry.exact import come_close, distance_at
from planning.transforms import Indices
from scheduling.conflicts.allowed_contacts import ContactTable
from scheduling.conflicts.close_bodies import Descent, start_descent
from scheduling.conflicts.occupancy import Occupancy
from scheduling.conflicts.staircase import next_proposal, raise_floor

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
