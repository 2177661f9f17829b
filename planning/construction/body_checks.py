"""Swept bodies of movers against boxes, themselves and pieces of other robots, compiled.

The movers have been swept by ``sweep_own``: capsules propose here, hulls decide.
"""

from __future__ import annotations

from numba import njit

from planning.construction.arena import Arena, Integers, column, row, table
from planning.construction.space_time_scene import (
    AROUND,
    BODY_ENTITY,
    BODY_FIRST,
    BODY_JOINT,
    BOX_BOUNDS,
    BOX_FROM,
    BOX_HALF,
    BOX_LIMIT,
    BOX_NUMBER,
    BOX_POSE,
    BOX_UNTIL,
    CAPSULE_FIRST,
    ENTITY_LIMIT,
    JOINT_FIRST,
    MIDDLE,
    MOVER,
    NEAR,
    OTHER_A,
    OTHER_B,
    OTHER_BOX,
    OTHER_MOVED,
    OTHER_QA,
    OTHER_QB,
    OTHER_RADIUS,
    OWN_A,
    OWN_B,
    OWN_BOX,
    OWN_LIMIT,
    OWN_MOVED,
    OWN_QA,
    OWN_QB,
    OWN_RADIUS,
    PAIRS,
    PIECE_A,
    PIECE_B,
    PIECE_BODY,
    PIECE_BOX,
    PIECE_CAPSULE,
    PIECE_CARRIER,
    PIECE_END,
    PIECE_START,
    PIECE_WHOLE,
    POSES,
    RADIUS,
    SETTINGS,
    SWEPT_A,
    SWEPT_B,
    SWEPT_BOX,
    SWEPT_RADIUS,
    WIDEST,
    apart,
    hulls_of,
    kernel_of,
    scratch_of,
    still_hulls,
)
from planning.construction.swept_track import bound_capsules
from planning.geometry.distance import segment_box, segment_segment
from planning.geometry.hull_table import HullTable
from planning.geometry.separation import hulls_stay_apart, pose_segments
from planning.geometry.swept import place_capsules
from planning.transforms import Array

CLEAR, SPLIT, BLOCKED = 0, 1, 2

_RESOLUTION = 0.06
"""Stretches that move no capsule further than this go to the hulls [m]."""

_FINEST = 1e-3
"""Own bodies that are not proved apart when they stray less than this touch [m]."""


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
    own = hulls_of(scene, m, _row(q_a, 0, len(q_a)), _row(q_b, 0, len(q_b)))
    scratch = scratch_of(scene)
    scratch.posed[0] = scratch.posed[1] = -1
    n = len(other_a)
    other = hulls_of(scene, v, _row(other_a, 0, n), _row(other_b, 0, n))
    pose_segments(own, 0, other, 0, scratch)
    j = p - bodies[v]
    return hulls_stay_apart(own, 0, o - bodies[m], other, 0, j, limit, scratch)


@njit(cache=True, nogil=True)
def pairs_apart(
    scene: Arena,
    count: int,
    limits: Array,
    other: HullTable,
    columns: Integers,
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
    own = hulls_of(scene, last, _row(q_a, joints[last], n), _row(q_b, joints[last], n))
    for c in range(count):
        o, j = pairs[c] // len(columns), pairs[c] % len(columns)
        m = mover[o]
        if m != last:
            last, n = m, joints[m + 1]
            own = hulls_of(scene, m, _row(q_a, joints[m], n), _row(q_b, joints[m], n))
            scratch.posed[0] = -1
        pose_segments(own, 0, other, 0, scratch)
        limit = limits[o, columns[j]]
        if not hulls_stay_apart(own, 0, o - bodies[m], other, 0, j, limit, scratch):
            return False
    return True


@njit(cache=True, nogil=True)
def _row(q: Array, first: int, last: int) -> Array:
    """Return a part of a configuration as the only row of a table."""
    return q[first:last].reshape(1, last - first)


@njit(cache=True, nogil=True)
def meet_boxes(scene: Arena, boxes: int, lo: float, hi: float) -> int:
    """Check the movers against the first boxes of NEAR that are there in a span.

    Returns:
        CLEAR, BLOCKED, or SPLIT where a shorter stretch must be looked at.
    """
    near, capsules = row(scene, NEAR), row(scene, CAPSULE_FIRST)
    around, own_box = column(scene, AROUND), table(scene, OWN_BOX)
    bounds, limits = table(scene, BOX_BOUNDS), table(scene, BOX_LIMIT)
    start, end = column(scene, BOX_FROM), column(scene, BOX_UNTIL)
    pose, half = table(scene, BOX_POSE), table(scene, BOX_HALF)
    a, b = table(scene, OWN_A), table(scene, OWN_B)
    radius, moved = column(scene, OWN_RADIUS), table(scene, OWN_MOVED)
    widest = column(scene, SETTINGS)[WIDEST]
    pairs, count = row(scene, PAIRS), boxes * 0
    for k in range(boxes):
        x = near[k]
        if (start[x] >= hi and hi > lo) or start[x] > hi or end[x] <= lo:
            continue
        if apart(around, bounds[x], widest):
            continue
        for o in range(len(own_box)):
            limit = limits[o, x]
            if limit < 0.0 or apart(own_box[o], bounds[x], limit):
                continue
            for c in range(capsules[o], capsules[o + 1]):
                reach = radius[c] + limit
                gap = segment_box(a[c], b[c], pose[4 * x : 4 * x + 4], half[x])
                if gap <= reach * reach:
                    if moved[c, 0] > _RESOLUTION:
                        return SPLIT
                    pairs[count] = o * len(bounds) + x
                    count += 1
                    break
    if count == 0:
        return CLEAR
    columns = row(scene, BOX_NUMBER)
    if pairs_apart(scene, count, limits, still_hulls(scene), columns):
        return CLEAR
    return BLOCKED


@njit(cache=True, nogil=True)
def meet_self(scene: Arena) -> int:
    """Check the bodies of each mover against each other; see ``meet_boxes``."""
    joints, bodies = row(scene, JOINT_FIRST), row(scene, BODY_FIRST)
    capsules, joint = row(scene, CAPSULE_FIRST), row(scene, BODY_JOINT)
    mover, own_box = row(scene, MOVER), table(scene, OWN_BOX)
    limits, bare = table(scene, OWN_LIMIT), column(scene, RADIUS)
    a, b, moved = table(scene, OWN_A), table(scene, OWN_B), table(scene, OWN_MOVED)
    q_a, q_b = column(scene, OWN_QA), column(scene, OWN_QB)
    for o in range(len(own_box)):
        m = mover[o]
        for p in range(bodies[m], o):
            limit = limits[p, o]
            if limit < 0.0 or apart(own_box[o], own_box[p], limit):
                continue
            # Seen from the joint that carries the lower body, only the joints above it move.
            root = min(joint[p], joint[o]) + 1
            strayed = -1.0
            for c in range(capsules[o], capsules[o + 1]):
                for d in range(capsules[p], capsules[p + 1]):
                    both = moved[c, root] + moved[d, root]
                    reach = bare[c] + bare[d] + both + limit
                    if segment_segment(a[c], b[c], a[d], b[d]) <= reach * reach:
                        strayed = max(strayed, both)
            if strayed < 0.0:
                continue
            if strayed > _RESOLUTION:
                return SPLIT
            j0, j1 = joints[m], joints[m + 1]
            from_q, to_q = q_a[j0:j1].copy(), q_b[j0:j1].copy()
            for j in range(root):
                from_q[j] = to_q[j] = 0.5 * (from_q[j] + to_q[j])
            if not proved_apart(scene, m, from_q, to_q, o, m, from_q, to_q, p, limit):
                return BLOCKED if strayed < _FINEST else SPLIT
    return CLEAR


@njit(cache=True, nogil=True)
def movers_clear(scene: Arena, decide: bool) -> bool:
    """Check the movers against each other; without a decision what is near is not clear."""
    joints, bodies = row(scene, JOINT_FIRST), row(scene, BODY_FIRST)
    capsules, mover = row(scene, CAPSULE_FIRST), row(scene, MOVER)
    own_box, limits = table(scene, OWN_BOX), table(scene, OWN_LIMIT)
    a, b, radius = table(scene, OWN_A), table(scene, OWN_B), column(scene, OWN_RADIUS)
    q_a, q_b = column(scene, OWN_QA), column(scene, OWN_QB)
    for o in range(len(own_box)):
        m = mover[o]
        for p in range(bodies[m]):
            limit = limits[p, o]
            if limit < 0.0 or apart(own_box[o], own_box[p], limit):
                continue
            if not capsules_meet(
                a,
                b,
                radius,
                capsules[o],
                capsules[o + 1],
                a,
                b,
                radius,
                capsules[p],
                capsules[p + 1],
                limit,
            ):
                continue
            if not decide:
                return False
            k = mover[p]
            i0, i1, j0, j1 = joints[m], joints[m + 1], joints[k], joints[k + 1]
            if not proved_apart(
                scene,
                m,
                q_a[i0:i1],
                q_b[i0:i1],
                o,
                k,
                q_a[j0:j1],
                q_b[j0:j1],
                p,
                limit,
            ):
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
def clear_of_pieces(scene: Arena, p: int, q: int, begin: float, finish: float) -> bool:
    """Check the movers against pieces ``range(p, q)`` of one track within a span."""
    joints, bodies = row(scene, JOINT_FIRST), row(scene, BODY_FIRST)
    around, widest = column(scene, AROUND), column(scene, SETTINGS)[WIDEST]
    boxes, carrier = table(scene, PIECE_BOX), row(scene, PIECE_CARRIER)
    start, end = column(scene, PIECE_START), column(scene, PIECE_END)
    whole, first = row(scene, PIECE_WHOLE), row(scene, PIECE_CAPSULE)
    first_body = row(scene, PIECE_BODY)
    for i in range(p, q):
        if apart(around, boxes[i], widest):
            continue
        v = carrier[i]
        n = joints[v + 1] - joints[v]
        c0, c1 = first[i], first[i + 1]
        b0, b1 = first_body[i], first_body[i + 1]
        q_a, q_b = table(scene, PIECE_A)[i, :n], table(scene, PIECE_B)[i, :n]
        a, b = table(scene, SWEPT_A)[c0:c1], table(scene, SWEPT_B)[c0:c1]
        radius = column(scene, SWEPT_RADIUS)[c0:c1]
        box = table(scene, SWEPT_BOX)[b0:b1]
        if whole[i] == 0 and (start[i] < begin - 1e-9 or end[i] > finish + 1e-9):
            moves = False
            for j in range(n):
                moves = moves or q_a[j] != q_b[j]
            if moves:
                _clip(scene, i, begin, finish)
                q_a, q_b = column(scene, OTHER_QA)[:n], column(scene, OTHER_QB)[:n]
                a, b = table(scene, OTHER_A), table(scene, OTHER_B)
                radius = column(scene, OTHER_RADIUS)
                box = table(scene, OTHER_BOX)[: b1 - b0]
        if not _bodies_clear(scene, v, bodies[v], a, b, radius, box, q_a, q_b):
            return False
    return True


@njit(cache=True, nogil=True)
def _clip(scene: Arena, piece: int, begin: float, finish: float) -> None:
    """Sweep only the part of a piece that falls into a span."""
    joints, bodies = row(scene, JOINT_FIRST), row(scene, BODY_FIRST)
    capsules, bare = row(scene, CAPSULE_FIRST), column(scene, RADIUS)
    start = column(scene, PIECE_START)[piece]
    span = column(scene, PIECE_END)[piece] - start
    v = row(scene, PIECE_CARRIER)[piece]
    n = joints[v + 1] - joints[v]
    x = min(max((begin - start) / span, 0.0), 1.0)
    y = min(max((finish - start) / span, 0.0), 1.0)
    q_a, q_b = column(scene, OTHER_QA), column(scene, OTHER_QB)
    from_q, to_q = table(scene, PIECE_A)[piece], table(scene, PIECE_B)[piece]
    for j in range(n):
        q_a[j] = from_q[j] + x * (to_q[j] - from_q[j])
        q_b[j] = from_q[j] + y * (to_q[j] - from_q[j])
    offset = capsules[bodies[v]]
    count = capsules[bodies[v + 1]] - offset
    a, b, moved = (
        table(scene, OTHER_A),
        table(scene, OTHER_B),
        table(scene, OTHER_MOVED),
    )
    radius, box = column(scene, OTHER_RADIUS), table(scene, OTHER_BOX)
    poses = table(scene, POSES)
    place_capsules(
        kernel_of(scene, v),
        q_a[:n],
        q_b[:n],
        poses.reshape(poses.shape[0] // 4, 4, 4),
        column(scene, MIDDLE)[:n],
        a[:count],
        b[:count],
        moved[:count],
    )
    for c in range(count):
        radius[c] = bare[offset + c] + moved[c, 0]
    for k in range(bodies[v], bodies[v + 1]):
        low, high = capsules[k] - offset, capsules[k + 1] - offset
        bound_capsules(a, b, radius, low, high, box[k - bodies[v]])


@njit(cache=True, nogil=True)
def _bodies_clear(
    scene: Arena,
    v: int,
    first: int,
    other_a: Array,
    other_b: Array,
    other_radius: Array,
    other_box: Array,
    other_qa: Array,
    other_qb: Array,
) -> bool:
    """Check all own bodies against another carrier's, each anywhere on its own motion."""
    joint, capsules = row(scene, BODY_JOINT), row(scene, CAPSULE_FIRST)
    entity, limits = row(scene, BODY_ENTITY), table(scene, ENTITY_LIMIT)
    around, own_box = column(scene, AROUND), table(scene, OWN_BOX)
    a, b, radius = table(scene, OWN_A), table(scene, OWN_B), column(scene, OWN_RADIUS)
    widest = column(scene, SETTINGS)[WIDEST]
    pairs, bodies, count = row(scene, PAIRS), len(other_box), v * 0
    for k in range(bodies):
        if apart(around, other_box[k], widest):
            continue
        p = first + k
        low, high = capsules[p] - capsules[first], capsules[p + 1] - capsules[first]
        for o in range(len(own_box)):
            limit = limits[o, entity[p]]
            if (
                limit < 0.0
                or apart(own_box[o], other_box[k], limit)
                or (joint[o] < 0 and joint[p] < 0)
                or not capsules_meet(
                    a,
                    b,
                    radius,
                    capsules[o],
                    capsules[o + 1],
                    other_a,
                    other_b,
                    other_radius,
                    low,
                    high,
                    limit,
                )
            ):
                continue
            pairs[count] = o * bodies + k
            count += 1
    if count == 0:
        return True
    n = len(other_qa)
    other = hulls_of(scene, v, _row(other_qa, 0, n), _row(other_qb, 0, n))
    columns = entity[first : first + bodies]
    return bool(pairs_apart(scene, count, limits, other, columns))
