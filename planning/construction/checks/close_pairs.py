"""Pairs of swept bodies, compiled: capsules propose, hulls decide."""

from __future__ import annotations

from numba import njit

from planning.construction.checks.arena import Arena, column, row
from planning.construction.checks.obstacles import (
    BODY_FIRST,
    JOINT_FIRST,
    MOVER,
    OWN_QA,
    OWN_QB,
    PAIRS,
    hulls_of,
    scratch_of,
)
from planning.geometry.distance import segment_segment
from planning.geometry.hull_table import HullTable
from planning.geometry.separation import hulls_stay_apart, pose_segments
from planning.transforms import Array, Indices


@njit(cache=True, nogil=True)
def proved_apart(
    scene: Arena,
    m: int,
    q_a: Array,
    q_b: Array,
    o: int,
    v: int,
    other_a: Array,
    other_b: Array,
    p: int,
    limit: float,
) -> bool:
    """Tell whether two bodies are proved to keep a distance, each anywhere on its motion.

    Args:
        scene: the scene.
        m: a carrier.
        q_a, q_b: ends of its motion, shape (n,).
        o: a body of it, counted in the fleet.
        v: another carrier.
        other_a, other_b: ends of its motion.
        p: a body of it, counted in the fleet.
        limit: the distance [m].
    """
    bodies = row(scene, BODY_FIRST)
    own = hulls_of(scene, m, as_row(q_a, 0, len(q_a)), as_row(q_b, 0, len(q_b)))
    scratch = scratch_of(scene)
    scratch.posed[0] = scratch.posed[1] = -1
    n = len(other_a)
    other = hulls_of(scene, v, as_row(other_a, 0, n), as_row(other_b, 0, n))
    pose_segments(own, 0, other, 0, scratch)
    j = p - bodies[v]
    return hulls_stay_apart(own, o - bodies[m], other, j, limit, scratch)


@njit(cache=True, nogil=True)
def pairs_apart(
    scene: Arena,
    count: int,
    limits: Array,
    other: HullTable,
    columns: Indices,
) -> bool:
    """Tell whether the first pairs of PAIRS are proved to keep their distances.

    What hulls are made of is looked up once for all of them: that takes longer than to prove
    two of them apart.

    Args:
        scene: the scene, with the movers swept.
        count: of pairs: the number of an own body times that of bodies in ``other``, plus the
            number of one of these.
        limits: least distance of an own body, by column, shape (o, columns) [m].
        other: what they are looked at against, one segment of it.
        columns: of each body of ``other`` in ``limits``.
    """
    joints, bodies, mover = (
        row(scene, JOINT_FIRST),
        row(scene, BODY_FIRST),
        row(scene, MOVER),
    )
    q_a, q_b, pairs = column(scene, OWN_QA), column(scene, OWN_QB), row(scene, PAIRS)
    scratch = scratch_of(scene)
    scratch.posed[0] = scratch.posed[1] = -1
    last = mover[pairs[0] // len(columns)]
    n = joints[last + 1]
    own = hulls_of(
        scene, last, as_row(q_a, joints[last], n), as_row(q_b, joints[last], n)
    )
    for c in range(count):
        o, j = pairs[c] // len(columns), pairs[c] % len(columns)
        m = mover[o]
        if m != last:
            last, n = m, joints[m + 1]
            own = hulls_of(
                scene, m, as_row(q_a, joints[m], n), as_row(q_b, joints[m], n)
            )
            scratch.posed[0] = -1
        pose_segments(own, 0, other, 0, scratch)
        limit = limits[o, columns[j]]
        if not hulls_stay_apart(own, o - bodies[m], other, j, limit, scratch):
            return False
    return True


@njit(cache=True, nogil=True)
def capsules_meet(
    a: Array,
    b: Array,
    radius: Array,
    first: int,
    last: int,
    other_a: Array,
    other_b: Array,
    other_radius: Array,
    other_first: int,
    other_last: int,
    limit: float,
) -> bool:
    """Tell whether capsules ``range(first, last)`` come within a limit of some others."""
    for c in range(first, last):
        for d in range(other_first, other_last):
            reach = radius[c] + other_radius[d] + limit
            if segment_segment(a[c], b[c], other_a[d], other_b[d]) <= reach * reach:
                return True
    return False


@njit(cache=True, nogil=True)
def as_row(q: Array, first: int, last: int) -> Array:
    """Return a part of a configuration as the only row of a table."""
    return q[first:last].reshape(1, last - first)
