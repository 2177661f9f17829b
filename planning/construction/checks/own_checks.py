"""Swept bodies of movers against those of the same and of other movers, compiled.

The movers have been swept by ``sweep_own``.
"""

from __future__ import annotations

from numba import njit

from planning.construction.checks.arena import Arena, column, row, table
from planning.construction.checks.box_checks import (
    BLOCKED,
    CLEAR,
    RESOLUTION,
    SPLIT,
)
from planning.construction.checks.close_pairs import capsules_meet, proved_apart
from planning.construction.checks.obstacles import (
    BODY_FIRST,
    BODY_JOINT,
    CAPSULE_FIRST,
    JOINT_FIRST,
    MOVER,
    OWN_A,
    OWN_B,
    OWN_BOX,
    OWN_LIMIT,
    OWN_MOVED,
    OWN_QA,
    OWN_QB,
    OWN_RADIUS,
    RADIUS,
    apart,
)
from planning.geometry.distance import segment_segment

_FINEST = 1e-3
"""Own bodies that are not proved apart when they stray less than this touch [m]."""


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
            if strayed > RESOLUTION:
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
