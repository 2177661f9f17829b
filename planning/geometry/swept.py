"""Capsules that contain everything a robot sweeps on a straight line in joint space.

Each capsule is placed at the middle of the line and its radius grown by a bound of how far any
of its points gets from there: joint by joint from the tip, a point within r of the joint's axis
(and displaced by at most m through the joints behind) moves at most (r + m) times half the
joint's travel. The bound is rigorous, so nothing between two samples goes unseen.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from planning.geometry.distance import segment_box, segment_segment
from planning.geometry.hull_table import HullTable
from planning.kernels import inner_kernel, kernel
from planning.kinematics.chain import joint_axis, pose_joints
from planning.packed import packed
from planning.transforms import Array


@inner_kernel
def place_capsules(
    hulls: HullTable,
    q_a: Array,
    q_b: Array,
    poses: Array,
    q_mid: Array,
    start: Array,
    end: Array,
    moved: Array,
) -> None:
    """Write the capsules at the middle of a joint-space segment and how far they stray.

    Args:
        hulls: bodies that a robot carries.
        q_a, q_b: ends of the segment, shape (n,).
        poses: scratch, shape (n + 1, 4, 4); holds the joint poses at the middle afterwards.
        q_mid: scratch, shape (n,).
        start, end: world ends of the capsule segments, shape (c, 3), written here [m].
        moved: bounds of the motion of each capsule's points, shape (c, n + 1), written here:
            ``moved[c, j + 1]`` in the frame of joint j, ``moved[c, 0]`` in the world [m].
    """
    n = q_a.shape[0]
    for j in range(n):
        q_mid[j] = 0.5 * (q_a[j] + q_b[j])
    robot, ends, first = hulls.robot, hulls.ends, hulls.capsule_first
    pose_joints(robot, q_mid, poses)
    for o in range(len(hulls.joint)):
        carrier = hulls.joint[o]
        for c in range(first[o], first[o + 1]):
            for r in range(3):
                s = e = poses[carrier + 1, r, 3]
                for k in range(3):
                    s += poses[carrier + 1, r, k] * ends[c, 0, k]
                    e += poses[carrier + 1, r, k] * ends[c, 1, k]
                start[c, r] = s
                end[c, r] = e
            strayed = 0.0
            for j in range(carrier + 1, n + 1):
                moved[c, j] = 0.0
            for j in range(carrier, -1, -1):
                half_travel = 0.5 * abs(q_b[j] - q_a[j])
                if half_travel == 0.0 or robot.prismatic[j]:
                    strayed += half_travel
                    moved[c, j] = strayed
                    continue
                axis = joint_axis(robot, poses, j)
                reach = max(
                    _off_axis(start, c, poses, j + 1, axis),
                    _off_axis(end, c, poses, j + 1, axis),
                )
                strayed += half_travel * (reach + hulls.radius[c] + strayed)
                moved[c, j] = strayed


@inner_kernel
def _off_axis(
    points: Array, c: int, poses: Array, p: int, axis: tuple[float, float, float]
) -> float:
    ax, ay, az = axis
    x = points[c, 0] - poses[p, 0, 3]
    y = points[c, 1] - poses[p, 1, 3]
    z = points[c, 2] - poses[p, 2, 3]
    cx, cy, cz = y * az - z * ay, z * ax - x * az, x * ay - y * ax
    return float(np.sqrt(cx * cx + cy * cy + cz * cz))


@kernel
def bound_travel(hulls: HullTable, q_a: Array, q_b: Array) -> Array:
    """Return how far any point of the robot travels in each of many segments, at most.

    Neighbours are bounded together: how far a capsule gets from a joint's axis while the
    joints are anywhere within the box of their values, times how far the joint goes.

    Args:
        hulls: bodies that a robot carries.
        q_a, q_b: ends of the segments, shape (s, n).

    Returns:
        Bounds, shape (s,) [m].
    """
    together = 8
    count, n = q_a.shape
    c = len(hulls.radius)
    start, end = np.empty((c, 3)), np.empty((c, 3))
    poses = np.empty((n + 1, 4, 4))
    q_mid, low, high = np.empty(n), np.empty(n), np.empty(n)
    moved = np.empty((c, n + 1))
    out = np.zeros(count)
    for first in range(0, count, together):
        last = min(first + together, count)
        for j in range(n):
            low[j] = high[j] = q_a[first, j]
            for i in range(first, last):
                low[j] = min(low[j], q_a[i, j], q_b[i, j])
                high[j] = max(high[j], q_a[i, j], q_b[i, j])
        place_capsules(hulls, low, high, poses, q_mid, start, end, moved)
        for j in range(n):
            half = 0.5 * (high[j] - low[j])
            for k in range(c):
                if half > 0.0:
                    moved[k, j] = (moved[k, j] - moved[k, j + 1]) / half
        for i in range(first, last):
            for k in range(c):
                travel = 0.0
                for j in range(n):
                    if high[j] > low[j]:
                        travel += abs(q_b[i, j] - q_a[i, j]) * moved[k, j]
                out[i] = max(out[i], travel)
    return out


@kernel
def boxes_in_reach(
    hulls: HullTable, path: Array, pose: Array, half: Array, room: float
) -> npt.NDArray[np.bool_]:
    """Return which boxes anything on a path may come near to: a coarse, safe choice.

    Args:
        hulls: the bodies of the robot, with all it ever holds on the path.
        path: configurations joined by straight lines, shape (w, n).
        pose: poses of the boxes, shape (b, 4, 4).
        half: their half edge lengths, shape (b, 3) [m].
        room: least distance that matters [m].

    Returns:
        Shape (b,). Boxes that are left out keep more than ``room`` from every swept capsule.
    """
    n, capsules = path.shape[1], len(hulls.radius)
    start, end = np.empty((capsules, 3)), np.empty((capsules, 3))
    poses, q_mid = np.empty((n + 1, 4, 4)), np.empty(n)
    moved = np.empty((capsules, n + 1))
    out = np.zeros(len(pose), dtype=np.bool_)
    low, high = _box_corners(pose, half)
    near = np.empty(capsules, dtype=np.int64)
    around = np.empty((2, 3))
    for s in range(len(path) - 1):
        place_capsules(hulls, path[s], path[s + 1], poses, q_mid, start, end, moved)
        # Most of a robot is far above all boxes, and most boxes are far from the rest of it.
        count = 0
        around[0], around[1] = np.inf, -np.inf
        for c in range(capsules):
            reach = hulls.radius[c] + moved[c, 0] + room
            apart = False
            for r in range(3):
                least = min(start[c, r], end[c, r]) - reach
                most = max(start[c, r], end[c, r]) + reach
                apart = apart or most < low[-1, r] or least > high[-1, r]
            if apart:
                continue
            near[count] = c
            count += 1
            for r in range(3):
                least = min(start[c, r], end[c, r]) - reach
                most = max(start[c, r], end[c, r]) + reach
                around[0, r] = min(around[0, r], least)
                around[1, r] = max(around[1, r], most)
        for b in range(len(pose)):
            if out[b]:
                continue
            apart = False
            for r in range(3):
                apart = apart or high[b, r] < around[0, r] or low[b, r] > around[1, r]
            if apart:
                continue
            for k in range(count):
                if out[b]:
                    break
                c = near[k]
                reach = hulls.radius[c] + moved[c, 0] + room
                # The distance to the middle of the capsule rules out most.
                far = apart_square = length = 0.0
                for r in range(3):
                    far += half[b, r] ** 2
                    middle = 0.5 * (start[c, r] + end[c, r])
                    apart_square += (middle - pose[b, r, 3]) ** 2
                    length += (end[c, r] - start[c, r]) ** 2
                far = np.sqrt(far) + 0.5 * np.sqrt(length) + reach
                if apart_square <= far * far:
                    gap = segment_box(start[c], end[c], pose[b], half[b])
                    out[b] = gap <= reach * reach
    return out


@inner_kernel
def _box_corners(pose: Array, half: Array) -> tuple[Array, Array]:
    """Return the least and greatest corners of boxes, and in a last row those around them all."""
    count = len(pose)
    low, high = np.empty((count + 1, 3)), np.empty((count + 1, 3))
    for r in range(3):
        low[count, r], high[count, r] = np.inf, -np.inf
        for b in range(count):
            reach = 0.0
            for k in range(3):
                reach += abs(pose[b, r, k]) * half[b, k]
            low[b, r], high[b, r] = pose[b, r, 3] - reach, pose[b, r, 3] + reach
            low[count, r] = min(low[count, r], low[b, r])
            high[count, r] = max(high[count, r], high[b, r])
    return low, high


SKIP = -1.0
"""In a table of limits: this pair is never checked."""

NOWHERE = -1.0
"""How far bodies stray that do not meet."""


class SweptBodies(NamedTuple):
    """Bodies on a stretch of motion.

    Attributes:
        hulls: the bodies, on that stretch.
        start, end: capsules in the middle of the stretch, shape (c, 3) [m].
        moved: how far they stray from there, see ``place_capsules``, shape (c, n + 1) [m].
        box: least and greatest corner of each body, shape (o, 6) [m].
        poses, middle: joints in the middle, shapes (n + 1, 4, 4) and (n,).
    """

    hulls: HullTable
    start: Array
    end: Array
    moved: Array
    box: Array
    poses: Array
    middle: Array


def make_swept(hulls: HullTable) -> SweptBodies:
    """Return the bodies of a robot on a stretch of motion of their own, not swept yet."""
    n, capsules = hulls.q_a.shape[1], len(hulls.radius)
    swept = SweptBodies(
        hulls.on_a_motion(),
        np.empty((capsules, 3)),
        np.empty((capsules, 3)),
        np.zeros((capsules, n + 1)),
        np.empty((len(hulls.joint), 6)),
        np.empty((n + 1, 4, 4)),
        np.empty(n),
    )
    return packed(swept)


def stand_still(hulls: HullTable) -> SweptBodies:
    """Return bodies that rest in the world."""
    start, end = np.array(hulls.ends[:, 0]), np.array(hulls.ends[:, 1])
    first, radius = hulls.capsule_first, hulls.radius[:, None]
    low, high = np.minimum(start, end) - radius, np.maximum(start, end) + radius
    box = np.hstack(
        [np.minimum.reduceat(low, first[:-1]), np.maximum.reduceat(high, first[:-1])]
    )
    moved, poses, middle = np.zeros((len(start), 1)), np.empty((1, 4, 4)), np.empty(0)
    return packed(SweptBodies(hulls, start, end, moved, box, poses, middle))


@inner_kernel
def go_along(hulls: HullTable, q_a: Array, q_b: Array, lo: float, hi: float) -> None:
    """Make a stretch of a straight motion the one that bodies are on.

    Args:
        hulls: the bodies.
        q_a, q_b: ends of the motion, shape (n,).
        lo, hi: ends of the stretch as shares of it.
    """
    for j in range(len(q_a)):
        step = q_b[j] - q_a[j]
        hulls.q_a[0, j], hulls.q_b[0, j] = q_a[j] + lo * step, q_a[j] + hi * step


@inner_kernel
def sweep_bodies(
    bodies: SweptBodies, q_a: Array, q_b: Array, lo: float, hi: float
) -> None:
    """Sweep a robot's bodies along a stretch of a straight motion; see ``go_along``."""
    hulls = bodies.hulls
    first, radius = hulls.capsule_first, hulls.radius
    start, end, moved, box = bodies.start, bodies.end, bodies.moved, bodies.box
    go_along(hulls, q_a, q_b, lo, hi)
    place_capsules(
        hulls,
        hulls.q_a[0],
        hulls.q_b[0],
        bodies.poses,
        bodies.middle,
        start,
        end,
        moved,
    )
    for o in range(len(first) - 1):
        for r in range(3):
            low, high = np.inf, -np.inf
            for c in range(first[o], first[o + 1]):
                grown = radius[c] + moved[c, 0]
                low = min(low, min(start[c, r], end[c, r]) - grown)
                high = max(high, max(start[c, r], end[c, r]) + grown)
            box[o, r], box[o, r + 3] = low, high


@inner_kernel
def strays_where_they_meet(
    a: SweptBodies,
    i: int,
    b: SweptBodies,
    j: int,
    root: int,
    limit: float,
    enough: float,
) -> float:
    """Return how far capsules of two bodies stray that come closer than a limit.

    Args:
        a, i: bodies, and one of them.
        b, j: likewise for the other.
        root: the joint from which they are seen plus one; 0 for the world.
        limit: least distance [m].
        enough: the first that stray further are good enough to return [m].

    Returns:
        The largest sum of what two such capsules stray [m], NOWHERE where there are none.
    """
    strayed = NOWHERE
    a_first, b_first = a.hulls.capsule_first, b.hulls.capsule_first
    a_radius, b_radius = a.hulls.radius, b.hulls.radius
    for c in range(a_first[i], a_first[i + 1]):
        for d in range(b_first[j], b_first[j + 1]):
            both = a.moved[c, root] + b.moved[d, root]
            near = a_radius[c] + b_radius[d] + both + limit
            gap = segment_segment(a.start[c], a.end[c], b.start[d], b.end[d])
            if gap <= near * near:
                strayed = max(strayed, both)
                if strayed > enough:
                    return float(strayed)
    return strayed
