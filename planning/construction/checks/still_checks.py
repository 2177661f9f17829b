"""Collision checks against static obstacles, and self-collision checks, in compiled code.

Capsules select the pairs of bodies that may collide. Only for these pairs convex hulls are compared. A motion is
bisected until each part of it is classified.
"""

from __future__ import annotations

from numba import boolean, float64

from planning.construction.checks.scene import MoverScene, sweep_stretch
from planning.geometry.clearing import pose_joints_above
from planning.geometry.distance import are_boxes_apart
from planning.geometry.separation import APART, check_hulls_continuously
from planning.geometry.swept import (
    NOWHERE,
    deviation_bound_at_box,
    deviation_bound_where_meeting,
)
from planning.joint_motion.moving_pairs import are_pairs_apart
from planning.kernels import ZERO, inner_kernel
from planning.packed import ROW, SharedKernel
from planning.transforms import Array

_CLEAR, _SPLIT, _BLOCKED = 0, 1, 2
"""Results of a check of a stretch; _SPLIT means undecided, so its halves are checked."""

_RESOLUTION = 0.06
"""Hulls are compared on a stretch only if no capsule moves further than this [m]."""

_FINEST = 1e-3
"""Own bodies count as touching if they are not proved apart on a stretch on which they move less than this [m]."""


def _still_clear(
    scene: MoverScene, q0: Array, t0: float, q1: Array, t1: float, leeway: float
) -> bool:
    """Tell whether a motion is clear of static obstacles and of self-collision.

    Args:
        scene: the scene.
        q0, t0: configuration and time of its start, shape (n,).
        q1, t1: configuration and time of its end.
        leeway: an obstacle that is present up to this long before or after a part of the motion counts, too [s].
    """
    sweep_stretch(scene, q0, t0, q1, t1, t0, t1)
    around, bounds, near = scene.own.sweeps.box, scene.boxes.bounds, scene.near
    start, end, widest = scene.boxes.start, scene.boxes.end, scene.widest
    boxes = ZERO
    for b in range(len(bounds)):
        if (start[b] >= t1 and t1 > t0) or start[b] > t1 or end[b] <= t0:
            continue
        if not are_boxes_apart(around, ZERO, bounds, b, widest):
            near[boxes] = b
            boxes += 1
    stack = scene.stack
    stack[0, 0], stack[0, 1] = t0, t1
    depth = 1
    while depth > 0:
        depth -= 1
        lo, hi = stack[depth, 0], stack[depth, 1]
        if lo > t0 or hi < t1:
            sweep_stretch(scene, q0, t0, q1, t1, lo, hi)
        found = _meet_boxes(scene, boxes, max(lo - leeway, t0), min(hi + leeway, t1))
        if found == _CLEAR:
            found = _meet_self(scene)
        if found == _CLEAR:
            continue
        if found == _BLOCKED or depth + 2 > len(stack) or hi - lo < 1e-9:
            return False
        middle = 0.5 * (lo + hi)
        stack[depth, 0], stack[depth, 1] = middle, hi
        stack[depth + 1, 0], stack[depth + 1, 1] = lo, middle
        depth += 2
    return True


STILL = SharedKernel(_still_clear, boolean, (ROW, float64, ROW, float64, float64))
_call = STILL.call_of("still")


@inner_kernel
def is_clear_of_still_objects(
    scene: MoverScene, q0: Array, t0: float, q1: Array, t1: float, leeway: float
) -> bool:
    """Entry point of ``_still_clear``, compiled once and shared by all callers."""
    return bool(_call(scene, (q0, float(t0), q1, float(t1), float(leeway))))


@inner_kernel
def _meet_boxes(scene: MoverScene, boxes: int, lo: float, hi: float) -> int:
    """Check the swept robot against the first ``boxes`` entries of ``near`` present in a time span."""
    near, pairs, limits = scene.near, scene.pairs, scene.limits.boxes
    own, counting = scene.own, scene.counting
    around, own_box, widest = own.sweeps.box, own.sweeps.body_box, scene.widest
    still = scene.boxes
    bounds, start, end = still.bounds, still.start, still.end
    pose, half = still.pose, still.half
    count = ZERO
    for k in range(boxes):
        x = near[k]
        if (start[x] >= hi and hi > lo) or start[x] > hi or end[x] <= lo:
            continue
        if are_boxes_apart(around, ZERO, bounds, x, widest):
            continue
        for o in range(len(own_box)):
            limit = limits[o, x]
            if limit < 0.0 or are_boxes_apart(own_box, o, bounds, x, limit):
                continue
            strayed = deviation_bound_at_box(own, o, pose[x], half[x], limit)
            if strayed > _RESOLUTION:
                return _SPLIT
            if strayed != NOWHERE:
                pairs[count] = o * len(bounds) + x
                count += 1
    mine, boxes_there = (own.hulls, counting), (still.hulls, counting[: len(bounds)])
    if count == 0 or are_pairs_apart(
        pairs, count, mine, boxes_there, limits, scene.scratch
    ):
        return _CLEAR
    return _BLOCKED


@inner_kernel
def _meet_self(scene: MoverScene) -> int:
    """Check the swept bodies of the robot against each other."""
    own, above, scratch = scene.own, scene.above, scene.scratch
    box, joint, limits = own.sweeps.body_box, own.hulls.joint, scene.limits.own
    for o in range(len(box)):
        for p in range(o):
            limit = limits[p, o]
            if limit < 0.0 or are_boxes_apart(box, o, box, p, limit):
                continue
            # Seen from the joint that carries the lower body, only the joints above it move.
            root = min(joint[p], joint[o])
            strayed = deviation_bound_where_meeting(own, o, p, root, limit, _RESOLUTION)
            if strayed > _RESOLUTION:
                return _SPLIT
            if strayed == NOWHERE:
                continue
            pose_joints_above(own.hulls, above, root, scratch)
            if check_hulls_continuously(above, o, above, p, limit, scratch) != APART:
                return _BLOCKED if strayed < _FINEST else _SPLIT
    return _CLEAR
