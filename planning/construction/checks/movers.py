"""Where the movers of a scene are, and what they sweep, compiled."""

from __future__ import annotations

import numpy as np
from numba import njit

from planning.construction.checks.arena import Arena, column, row, table
from planning.construction.checks.obstacles import (
    AROUND,
    BEGIN,
    BODY_FIRST,
    CAPSULE_FIRST,
    JOINT_FIRST,
    MIDDLE,
    OWN_A,
    OWN_B,
    OWN_BOX,
    OWN_MOVED,
    OWN_QA,
    OWN_QB,
    OWN_RADIUS,
    POSES,
    RADIUS,
    kernel_of,
)
from planning.construction.world.swept_track import bound_capsules
from planning.geometry.swept import place_capsules
from planning.transforms import Array


@njit(cache=True, nogil=True)
def own_at(
    scene: Arena, q0: Array, t0: float, q1: Array, t1: float, t: float, out: Array
) -> None:
    """Write where the movers are at a time: each goes straight once it is free to move."""
    begins, joints = column(scene, BEGIN), row(scene, JOINT_FIRST)
    for m in range(len(begins)):
        begin = max(t0, begins[m])
        if t <= begin and t < t1:
            share = 0.0
        elif t >= t1:
            share = 1.0 if begin < t1 or t0 >= t1 else 0.0
        else:
            share = (t - begin) / (t1 - begin)
        for j in range(joints[m], joints[m + 1]):
            out[j] = q1[j] if share == 1.0 else q0[j] + share * (q1[j] - q0[j])


@njit(cache=True, nogil=True)
def sweep_own(scene: Arena, lo: float, hi: float) -> None:
    """Sweep the movers from OWN_QA to OWN_QB in the span from ``lo`` to ``hi``.

    Movers that are not free to move by then are nowhere.
    """
    joints, bodies = row(scene, JOINT_FIRST), row(scene, BODY_FIRST)
    capsules = row(scene, CAPSULE_FIRST)
    q_a, q_b = column(scene, OWN_QA), column(scene, OWN_QB)
    start, end = table(scene, OWN_A), table(scene, OWN_B)
    moved = table(scene, OWN_MOVED)
    radius, bare = column(scene, OWN_RADIUS), column(scene, RADIUS)
    box, around = table(scene, OWN_BOX), column(scene, AROUND)
    begin = column(scene, BEGIN)
    poses = table(scene, POSES)
    for r in range(3):
        around[r] = np.inf
        around[r + 3] = -np.inf
    for m in range(len(begin)):
        if begin[m] > lo + 1e-9 and begin[m] >= hi - 1e-9:
            for o in range(bodies[m], bodies[m + 1]):
                for r in range(3):
                    box[o, r] = np.inf
                    box[o, r + 3] = -np.inf
            continue
        j0, j1 = joints[m], joints[m + 1]
        c0, c1 = capsules[bodies[m]], capsules[bodies[m + 1]]
        place_capsules(
            kernel_of(scene, m),
            q_a[j0:j1],
            q_b[j0:j1],
            poses.reshape(poses.shape[0] // 4, 4, 4),
            column(scene, MIDDLE)[: j1 - j0],
            start[c0:c1],
            end[c0:c1],
            moved[c0:c1],
        )
        for c in range(c0, c1):
            radius[c] = bare[c] + moved[c, 0]
        for o in range(bodies[m], bodies[m + 1]):
            bound_capsules(start, end, radius, capsules[o], capsules[o + 1], box[o])
            for r in range(3):
                around[r] = min(around[r], box[o, r])
                around[r + 3] = max(around[r + 3], box[o, r + 3])


@njit(cache=True, nogil=True)
def sweep_between(scene: Arena, q0: Array, q1: Array, lo: float, hi: float) -> None:
    """Sweep the movers from one configuration to another, both of shape (n,); see ``sweep_own``."""
    column(scene, OWN_QA)[:] = q0
    column(scene, OWN_QB)[:] = q1
    sweep_own(scene, lo, hi)
