"""Collision checks against all that lies still, and of robots with themselves, compiled.

Capsules propose pairs of bodies, hulls decide. A motion is halved until either is clear.
"""

from __future__ import annotations

from planning.construction.checks.scene import MoversScene, sweep_stretch
from planning.construction.world.tracks import Sweeps, bodies_of, set_motion
from planning.geometry.distance import boxes_apart, segment_box, segment_segment
from planning.geometry.hull_table import HullTable
from planning.geometry.separation import (
    APART,
    Scratch,
    judge_hulls,
    pose_segments,
)
from planning.kernels import ZERO, inner_kernel
from planning.transforms import Array, Indices


@inner_kernel
def proved_apart(
    scratch: Scratch, a: HullTable, i: int, b: HullTable, j: int, limit: float
) -> bool:
    """Tell whether two bodies are proved to keep a distance, each anywhere on its motion.

    Args:
        scratch: room to work in.
        a, i: a carrier on its motion, and a body of it.
        b, j: another one, or the same.
        limit: the distance [m].
    """
    scratch.posed[0] = scratch.posed[1] = -1
    pose_segments(a, ZERO, b, ZERO, scratch)
    return bool(judge_hulls(a, i, b, j, limit, scratch) == APART)


@inner_kernel
def pairs_apart(
    scene: MoversScene, count: int, limits: Array, other: HullTable, columns: Indices
) -> bool:
    """Tell whether the first of a scene's pairs are proved to keep their distances.

    Args:
        scene: the scene, with the movers swept.
        count: of pairs: the number of an own body times that of bodies in ``other``, plus the
            number of one of these.
        limits: least distance of an own body, by column, shape (o, columns) [m].
        other: what they are looked at against, one segment of it.
        columns: of each body of ``other`` in ``limits``.
    """
    bodies, mover, pairs = scene.fleet.body_first, scene.mover, scene.pairs
    scratch, last = scene.scratch, -1
    scratch.posed[1] = -1
    for c in range(count):
        o, j = pairs[c] // len(columns), pairs[c] % len(columns)
        m = mover[o]
        own = bodies_of(scene.fleet, m)
        if m != last:
            first = scene.joint_first[m]
            set_motion(own, scene.q_a[first:], scene.q_b[first:])
            scratch.posed[0], last = -1, m
        pose_segments(own, ZERO, other, ZERO, scratch)
        limit = limits[o, columns[j]]
        if judge_hulls(own, o - bodies[m], other, j, limit, scratch) != APART:
            return False
    return True


@inner_kernel
def capsules_meet(
    a: Sweeps, first: int, last: int, b: Sweeps, low: int, high: int, limit: float
) -> bool:
    """Tell whether capsules ``range(first, last)`` come within a limit of ``range(low, high)``."""
    a_start, a_end, a_radius = a.capsule_a, a.capsule_b, a.radius
    b_start, b_end, b_radius = b.capsule_a, b.capsule_b, b.radius
    for c in range(first, last):
        for d in range(low, high):
            reach = a_radius[c] + b_radius[d] + limit
            gap = segment_segment(a_start[c], a_end[c], b_start[d], b_end[d])
            if gap <= reach * reach:
                return True
    return False


_CLEAR, _SPLIT, _BLOCKED = 0, 1, 2
"""Answers: a shorter stretch must be looked at where it is _SPLIT."""

_RESOLUTION = 0.06
"""Stretches that move no capsule further than this go to the hulls [m]."""

_FINEST = 1e-3
"""Own bodies that are not proved apart when they stray less than this touch [m]."""


@inner_kernel
def still_clear_until(
    scene: MoversScene, q0: Array, t0: float, q1: Array, t1: float, leeway: float
) -> tuple[bool, float]:
    """Tell whether a motion is clear of all that lies still and of itself, and until when it is.

    Args:
        scene: the scene.
        q0, t0: where it begins, and when, shape (n,).
        q1, t1: where it ends, and when.
        leeway: what lies there so long before or after a bit of it counts, too [s].
    """
    sweep_stretch(scene, q0, t0, q1, t1, t0, t1)
    around, bounds, near = scene.own.box, scene.boxes.bounds, scene.near
    start, end, widest = scene.boxes.start, scene.boxes.end, scene.widest
    # Counted from a variable: numba compiles a function anew for every constant it is given.
    boxes = len(bounds) * 0
    for b in range(len(bounds)):
        if (start[b] >= t1 and t1 > t0) or start[b] > t1 or end[b] <= t0:
            continue
        if not boxes_apart(around, ZERO, bounds, b, widest):
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
            return False, lo
        middle = 0.5 * (lo + hi)
        stack[depth, 0], stack[depth, 1] = middle, hi
        stack[depth + 1, 0], stack[depth + 1, 1] = lo, middle
        depth += 2
    return True, t1


@inner_kernel
def lies_throughout(scene: MoversScene, t0: float, t1: float) -> bool:
    """Tell whether all near the stretch that was last swept lies there throughout a span.

    After ``still_clear_until`` has found a motion blocked that is where it is.

    Args:
        scene: the scene.
        t0, t1: the span [s].
    """
    bounds, start, end = scene.boxes.bounds, scene.boxes.start, scene.boxes.end
    around, widest = scene.own.box, scene.widest
    for b in range(len(bounds)):
        changes = t0 < start[b] <= t1 or t0 < end[b] <= t1
        if changes and not boxes_apart(around, ZERO, bounds, b, widest):
            return False
    return True


@inner_kernel
def _meet_boxes(scene: MoversScene, boxes: int, lo: float, hi: float) -> int:
    """Check the swept movers against the first boxes of ``near`` that are there in a span."""
    near, pairs, capsules = scene.near, scene.pairs, scene.capsule_first
    own, moved, limits = scene.own, scene.moved, scene.limits.boxes
    around, own_box, widest = own.box, own.body_box, scene.widest
    a, b, radius = own.capsule_a, own.capsule_b, own.radius
    still = scene.boxes
    bounds, start, end = still.bounds, still.start, still.end
    pose, half = still.pose, still.half
    count = boxes * 0
    for k in range(boxes):
        x = near[k]
        if (start[x] >= hi and hi > lo) or start[x] > hi or end[x] <= lo:
            continue
        if boxes_apart(around, ZERO, bounds, x, widest):
            continue
        for o in range(len(own_box)):
            limit = limits[o, x]
            if limit < 0.0 or boxes_apart(own_box, o, bounds, x, limit):
                continue
            for c in range(capsules[o], capsules[o + 1]):
                reach = radius[c] + limit
                gap = segment_box(a[c], b[c], pose[x], half[x])
                if gap <= reach * reach:
                    if moved[c, 0] > _RESOLUTION:
                        return _SPLIT
                    pairs[count] = o * len(bounds) + x
                    count += 1
                    break
    if count == 0 or pairs_apart(scene, count, limits, still.hulls, still.number):
        return _CLEAR
    return _BLOCKED


@inner_kernel
def _meet_self(scene: MoversScene) -> int:
    """Check the swept bodies of each mover against each other."""
    joints, bodies, mover = scene.joint_first, scene.fleet.body_first, scene.mover
    capsules, joint, limits = scene.capsule_first, scene.joint, scene.limits.own
    own, moved = scene.own, scene.moved
    box, a, b = own.body_box, own.capsule_a, own.capsule_b
    for o in range(len(box)):
        m = mover[o]
        first = bodies[m]
        for p in range(first, o):
            limit = limits[p, o]
            if limit < 0.0 or boxes_apart(box, o, box, p, limit):
                continue
            # Seen from the joint that carries the lower body, only the joints above it move.
            root = min(joint[p], joint[o]) + 1
            hulls = bodies_of(scene.fleet, m)
            bare, c0 = hulls.radius, capsules[first]
            strayed = -1.0
            for c in range(capsules[o], capsules[o + 1]):
                for d in range(capsules[p], capsules[p + 1]):
                    both = moved[c, root] + moved[d, root]
                    reach = bare[c - c0] + bare[d - c0] + both + limit
                    if segment_segment(a[c], b[c], a[d], b[d]) <= reach * reach:
                        strayed = max(strayed, both)
            if strayed < 0.0:
                continue
            if strayed > _RESOLUTION:
                return _SPLIT
            set_motion(hulls, scene.q_a[joints[m] :], scene.q_b[joints[m] :])
            q_a, q_b = hulls.q_a, hulls.q_b
            for j in range(root):
                q_a[0, j] = q_b[0, j] = 0.5 * (q_a[0, j] + q_b[0, j])
            if not proved_apart(
                scene.scratch, hulls, o - first, hulls, p - first, limit
            ):
                return _BLOCKED if strayed < _FINEST else _SPLIT
    return _CLEAR


@inner_kernel
def movers_clear(scene: MoversScene, decide: bool) -> bool:
    """Check the swept movers against each other; without a decision what is near is not clear."""
    joints, bodies, mover = scene.joint_first, scene.fleet.body_first, scene.mover
    capsules, limits, own = scene.capsule_first, scene.limits.own, scene.own
    box, q_a, q_b = own.body_box, scene.q_a, scene.q_b
    for o in range(len(box)):
        m = mover[o]
        for p in range(bodies[m]):
            limit = limits[p, o]
            if limit < 0.0 or boxes_apart(box, o, box, p, limit):
                continue
            c0, c1, d0, d1 = (
                capsules[o],
                capsules[o + 1],
                capsules[p],
                capsules[p + 1],
            )
            if not capsules_meet(own, c0, c1, own, d0, d1, limit):
                continue
            if not decide:
                return False
            k = mover[p]
            a, b = bodies_of(scene.fleet, m), bodies_of(scene.fleet, k)
            set_motion(a, q_a[joints[m] :], q_b[joints[m] :])
            set_motion(b, q_a[joints[k] :], q_b[joints[k] :])
            if not proved_apart(
                scene.scratch, a, o - bodies[m], b, p - bodies[k], limit
            ):
                return False
    return True
