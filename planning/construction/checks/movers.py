"""The movers of a scene: where they are, and what they sweep, compiled."""

from __future__ import annotations

import numpy as np

from planning.construction.checks.scene import Scene
from planning.construction.world.fleet import bodies_of
from planning.construction.world.swept_track import sweep_carrier
from planning.kernels import inner_kernel
from planning.transforms import Array


@inner_kernel
def own_at(
    scene: Scene, q0: Array, t0: float, q1: Array, t1: float, t: float, out: Array
) -> None:
    """Write where the movers are at a time: each goes straight once it is free to move."""
    begins, joints = scene.begin, scene.joint_first
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


@inner_kernel
def sweep_stretch(
    scene: Scene, q0: Array, t0: float, q1: Array, t1: float, lo: float, hi: float
) -> None:
    """Sweep the movers on the part from ``lo`` to ``hi`` of a motion; see ``own_at``."""
    own_at(scene, q0, t0, q1, t1, lo, scene.q_a)
    own_at(scene, q0, t0, q1, t1, hi, scene.q_b)
    _sweep(scene, lo, hi)


@inner_kernel
def sweep_between(scene: Scene, q0: Array, q1: Array, lo: float, hi: float) -> None:
    """Sweep the movers from one configuration to another, both of shape (n,), in a span."""
    scene.q_a[:] = q0
    scene.q_b[:] = q1
    _sweep(scene, lo, hi)


@inner_kernel
def _sweep(scene: Scene, lo: float, hi: float) -> None:
    """Sweep the movers; those that are not free to move by then are nowhere."""
    joints, bodies = scene.joint_first, scene.fleet.body_first
    capsules, begin = scene.capsule_first, scene.begin
    own, box, around = scene.own, scene.own.body_box, scene.own.box
    for r in range(3):
        around[0, r] = np.inf
        around[0, r + 3] = -np.inf
    for m in range(len(begin)):
        b0, b1 = bodies[m], bodies[m + 1]
        if begin[m] > lo + 1e-9 and begin[m] >= hi - 1e-9:
            for o in range(b0, b1):
                for r in range(3):
                    box[o, r] = np.inf
                    box[o, r + 3] = -np.inf
            continue
        j0, j1, c0 = joints[m], joints[m + 1], capsules[b0]
        q_a, q_b = scene.q_a[j0:j1], scene.q_b[j0:j1]
        moved = scene.moved[c0 : capsules[b1]]
        hulls = bodies_of(scene.fleet, m)
        sweep_carrier(hulls, q_a, q_b, (b0, c0), own, moved, scene.room)
        for o in range(b0, b1):
            for r in range(3):
                around[0, r] = min(around[0, r], box[o, r])
                around[0, r + 3] = max(around[0, r + 3], box[o, r + 3])
