"""Collision checks of whole motions, compiled; what they cannot prove is left to the exact decision.

Capsules propose pairs of bodies; those whose hulls are proved apart are dropped.
"""

from __future__ import annotations

import numpy as np

from planning.geometry.exact import TOLERANCE
from planning.geometry.proposals import BOX, SELF, Scene, propose
from planning.geometry.separation import APART, CONFLICT, judge_hulls, pose_segments
from planning.geometry.swept_bodies import go_along
from planning.kernels import ZERO, inner_kernel, kernel
from planning.transforms import Array, Indices

_ROOM = ZERO + 64

HIT = -1
"""In the place of a probe: somewhere the robot is too close to something."""


@inner_kernel
def _pose_above(scene: Scene, root: int) -> None:
    """Pose the stretch as it is seen from a joint: only the joints above it move."""
    whole, above, scratch = scene.own.hulls, scene.above, scene.on_itself
    for j in range(whole.q_a.shape[1]):
        a, b = whole.q_a[0, j], whole.q_b[0, j]
        if j <= root:
            a = b = 0.5 * (a + b)
        above.q_a[0, j], above.q_b[0, j] = a, b
    scratch.posed[0] = scratch.posed[1] = -1
    pose_segments(above, ZERO, above, ZERO, scratch)


@inner_kernel
def _keep_unproved(
    scene: Scene,
    q_a: Array,
    q_b: Array,
    when: Array,
    what: Indices,
    count: int,
    stop: bool,
) -> int:
    """Move the proposals that are not proved apart to the front; return how many there are.

    With ``stop`` set, HIT as soon as one of them is proved too close.
    """
    whole, above = scene.own.hulls, scene.above
    on_standing, on_itself = scene.on_standing, scene.on_itself
    lo = hi = -1.0
    root = -2
    kept = 0
    for k in range(count):
        kind, i, j = what[k, 0], what[k, 1], what[k, 2]
        if when[k, 0] != lo or when[k, 1] != hi:
            lo, hi = when[k, 0], when[k, 1]
            go_along(whole, q_a, q_b, lo, hi)
            on_standing.posed[0] = -1
            root = -2
        if kind == SELF:
            lower = min(whole.joint[i], whole.joint[j])
            if lower != root:
                root = lower
                _pose_above(scene, root)
            for r in range(3):
                on_itself.direction[r] = 0.0
            # What the exact decision tolerates is left to it.
            limit = scene.self_limit[i, j] + TOLERANCE
            answer = judge_hulls(above, i, above, j, limit, on_itself)
        else:
            limits = scene.box_limit if kind == BOX else scene.solid_limit
            standing = scene.boxes if kind == BOX else scene.others.hulls
            pose_segments(whole, ZERO, standing, ZERO, on_standing)
            answer = judge_hulls(whole, i, standing, j, limits[i, j], on_standing)
        if stop and answer == CONFLICT and kind != SELF:
            return HIT
        if answer != APART:
            when[kept, 0], when[kept, 1] = lo, hi
            for c in range(3):
                what[kept, c] = what[k, c]
            kept += 1
    return kept


@kernel
def find_undecided(
    scene: Scene, q_a: Array, q_b: Array, probes: Array, begin: int, stop: bool
) -> tuple[int, Array, Indices]:
    """Look at some configurations of a motion, then at all of it, until something is undecided.

    Args:
        scene: the robot and what stands around it.
        q_a, q_b: ends of the motion, shape (n,).
        probes: parameters in [0, 1] of the configurations to look at first, shape (p,).
        begin: the first of them to look at; p for the motion as a whole.
        stop: whether one pair that is proved too close is enough to know.

    Returns:
        The number of the probe (p for the whole motion, p + 1 when all is clear, HIT for a pair
        that is too close), and of what is undecided there the stretches as shares of the
        motion, shape (k, 2), and rows (kind, own body, other), shape (k, 3).
    """
    for k in range(begin, len(probes) + 1):
        lo, hi = 0.0, 1.0
        if k < len(probes):
            lo = hi = probes[k]
        room = _ROOM
        count = -1
        while count < 0:
            room *= 8
            when, what, count = propose(scene, q_a, q_b, lo, hi, room)
        if count > 0:
            count = _keep_unproved(scene, q_a, q_b, when, what, count, stop)
        if count == HIT:
            return HIT, when[:0].copy(), what[:0].copy()
        if count > 0:
            return k, when[:count].copy(), what[:count].copy()
    return len(probes) + 1, np.empty((0, 2)), np.empty((0, 3), dtype=np.int64)
