"""Swept bodies of movers against pieces of other robots' motions, compiled.

The movers have been swept by ``sweep_own``.
"""

from __future__ import annotations

from numba import njit

from planning.construction.checks.arena import Arena, column, row, table
from planning.construction.checks.close_pairs import (
    as_row,
    capsules_meet,
    pairs_apart,
)
from planning.construction.checks.obstacles import (
    AROUND,
    BODY_ENTITY,
    BODY_FIRST,
    BODY_JOINT,
    CAPSULE_FIRST,
    ENTITY_LIMIT,
    JOINT_FIRST,
    MIDDLE,
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
)
from planning.construction.world.swept_track import bound_capsules
from planning.geometry.swept import place_capsules
from planning.transforms import Array


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
    other = hulls_of(scene, v, as_row(other_qa, 0, n), as_row(other_qb, 0, n))
    columns = entity[first : first + bodies]
    return bool(pairs_apart(scene, count, limits, other, columns))
