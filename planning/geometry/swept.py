"""Capsules that contain the swept volume of a robot on a straight line in joint space.

Each capsule is placed at the midpoint of the line. Its radius is increased by a bound on the displacement of its
points from there, summed over the joints from the tip to the base. A point at distance r from the axis of a joint,
already displaced by at most m, moves by at most (r + m) times half the travel of the joint. The bound is rigorous:
it holds on the whole line.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from planning.geometry.distance import (
    are_boxes_apart,
    is_segment_near_box,
    segment_segment,
)
from planning.geometry.hull_table import HullTable
from planning.kernels import ZERO, inner_kernel, kernel
from planning.kinematics.chain import joint_axis, pose_joints
from planning.packed import packed
from planning.transforms import Array, Indices

SKIP = -1.0
"""In a table of limits: this pair is never checked."""

NOWHERE = -1.0
"""Deviation of bodies that do not meet."""


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
    """Write the capsules at the middle of a joint-space segment and bounds on their deviation.

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
                reach = np.sqrt(
                    max(
                        _off_axis(start, c, poses, j + 1, axis),
                        _off_axis(end, c, poses, j + 1, axis),
                    )
                )
                strayed += half_travel * (reach + hulls.radius[c] + strayed)
                moved[c, j] = strayed


@inner_kernel
def _off_axis(
    points: Array, c: int, poses: Array, p: int, axis: tuple[float, float, float]
) -> float:
    """Return the squared distance of a point from the axis of a joint [m^2]."""
    ax, ay, az = axis
    x = points[c, 0] - poses[p, 0, 3]
    y = points[c, 1] - poses[p, 1, 3]
    z = points[c, 2] - poses[p, 2, 3]
    cx, cy, cz = y * az - z * ay, z * ax - x * az, x * ay - y * ax
    return float(cx * cx + cy * cy + cz * cz)


@kernel
def bound_travel(hulls: HullTable, q_a: Array, q_b: Array) -> Array:
    """Return a bound on the travel of any point of the robot in each of many segments.

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


class Sweeps(NamedTuple):
    """Bounds of the swept volumes of bodies in pieces of motion.

    Attributes:
        box: least and greatest corner of what a piece sweeps, shape (p, 6).
        body_first: where a piece's bodies begin in ``body_box``, shape (p + 1,).
        body_box: likewise of every body, shape (bodies of all pieces, 6).
        capsule_first: where a piece's capsules begin in the next three, shape (p + 1,).
        capsule_a, capsule_b, radius: swept capsules, shapes (c, 3), (c, 3), (c,).
    """

    box: Array
    body_first: Indices
    body_box: Array
    capsule_first: Indices
    capsule_a: Array
    capsule_b: Array
    radius: Array


def empty_sweeps(
    bodies: Sequence[int] | Indices, capsules: Sequence[int] | Indices
) -> Sweeps:
    """Return empty sweeps for a number of pieces, with the given bodies and capsules each."""
    body_first, capsule_first = (
        np.cumsum([0, *counts]).astype(np.int64) for counts in (bodies, capsules)
    )
    count = int(capsule_first[-1])
    return Sweeps(
        np.zeros((len(bodies), 6)),
        body_first,
        np.zeros((int(body_first[-1]), 6)),
        capsule_first,
        np.zeros((count, 3)),
        np.zeros((count, 3)),
        np.zeros(count),
    )


class SweepRoom(NamedTuple):
    """Work arrays for sweeping bodies.

    Attributes:
        poses: of joints, shape (n + 1, 4, 4).
        middle: a configuration, shape (n,).
        moved: how far capsules strayed that were swept last, see ``place_capsules``, shape
            (c, n + 1).
    """

    poses: Array
    middle: Array
    moved: Array


def make_sweep_room(joints: int, capsules: int) -> SweepRoom:
    """Return work arrays for a robot with a maximum number of joints and capsules."""
    room = SweepRoom(
        np.empty((joints + 1, 4, 4)), np.empty(joints), np.zeros((capsules, joints + 1))
    )
    return packed(room)


@inner_kernel
def sweep_piece(
    hulls: HullTable, q_a: Array, q_b: Array, p: int, out: Sweeps, room: SweepRoom
) -> None:
    """Write the capsules and the boxes of bodies on a straight motion.

    Args:
        hulls: the bodies.
        q_a, q_b: ends of their motion, shape (n,).
        p: which piece of ``out`` it is.
        out: written.
        room: work array.
    """
    body, start = out.body_first[p], out.capsule_first[p]
    capsules, count, moved = hulls.capsule_first, len(hulls.radius), room.moved
    a, b, radius = out.capsule_a, out.capsule_b, out.radius
    place_capsules(
        hulls,
        q_a,
        q_b,
        room.poses,
        room.middle[: len(q_a)],
        a[start : start + count],
        b[start : start + count],
        moved,
    )
    bare, box, around = hulls.radius, out.body_box, out.box
    error, poses = hulls.robot.error, room.poses
    for c in range(count):
        radius[start + c] = bare[c] + moved[c, 0]
        if error[0] > 0.0 or error[1] > 0.0:
            far = 0.0
            for ends in (a, b):
                away = 0.0
                for r in range(3):
                    away += (ends[start + c, r] - poses[0, r, 3]) ** 2
                far = max(far, np.sqrt(away))
            radius[start + c] += error[0] + error[1] * (far + radius[start + c])
    for r in range(3):
        around[p, r], around[p, r + 3] = np.inf, -np.inf
    for k in range(len(hulls.joint)):
        low, high = start + capsules[k], start + capsules[k + 1]
        for c in range(low, high):
            radius[c] += hulls.deviates[k]
        for r in range(3):
            least, most = np.inf, -np.inf
            for c in range(low, high):
                least = min(least, min(a[c, r], b[c, r]) - radius[c])
                most = max(most, max(a[c, r], b[c, r]) + radius[c])
            box[body + k, r], box[body + k, r + 3] = least, most
            around[p, r] = min(around[p, r], least)
            around[p, r + 3] = max(around[p, r + 3], most)


class SweptBodies(NamedTuple):
    """Bodies on a stretch of motion.

    Attributes:
        hulls: the bodies, on that stretch.
        sweeps: their swept volumes there, as one piece.
        room: how far their capsules deviate there.
    """

    hulls: HullTable
    sweeps: Sweeps
    room: SweepRoom


def make_swept(hulls: HullTable) -> SweptBodies:
    """Return the bodies of a robot on a stretch of motion of their own, not swept yet."""
    capsules = len(hulls.radius)
    return packed(
        SweptBodies(
            hulls.on_a_motion(),
            packed(empty_sweeps([len(hulls.joint)], [capsules])),
            make_sweep_room(hulls.q_a.shape[1], capsules),
        )
    )


@inner_kernel
def set_stretch(hulls: HullTable, q_a: Array, q_b: Array, lo: float, hi: float) -> None:
    """Set the stretch of a straight motion that bodies are on.

    Args:
        hulls: the bodies.
        q_a, q_b: ends of the motion, shape (n,).
        lo, hi: ends of the stretch as shares of it.
    """
    for j in range(len(q_a)):
        step = q_b[j] - q_a[j]
        hulls.q_a[0, j], hulls.q_b[0, j] = q_a[j] + lo * step, q_a[j] + hi * step


@inner_kernel
def sweep_bodies(bodies: SweptBodies) -> None:
    """Sweep bodies along their current stretch."""
    hulls = bodies.hulls
    sweep_piece(hulls, hulls.q_a[0], hulls.q_b[0], ZERO, bodies.sweeps, bodies.room)


@inner_kernel
def deviation_bound_at_box(
    bodies: SweptBodies, o: int, pose: Array, half: Array, limit: float
) -> float:
    """Return the deviation bound of the capsules of a body near a box, NOWHERE where none is near.

    Args:
        bodies, o: bodies, and one of them.
        pose, half: of the box, shapes (4, 4) and (3,).
        limit: least distance [m].
    """
    first, sweeps = bodies.hulls.capsule_first, bodies.sweeps
    a, b, radius = sweeps.capsule_a, sweeps.capsule_b, sweeps.radius
    for c in range(first[o], first[o + 1]):
        if is_segment_near_box(a[c], b[c], pose, half, radius[c] + limit):
            return float(bodies.room.moved[c, 0])
    return NOWHERE


@kernel
def boxes_in_reach(
    bodies: SweptBodies,
    path: Array,
    pose: Array,
    half: Array,
    bounds: Array,
    room: float,
) -> npt.NDArray[np.bool_]:
    """Return which boxes a path may come near to, conservatively.

    Args:
        bodies: of the robot, with all it ever holds on the path.
        path: configurations joined by straight lines, shape (w, n).
        pose: poses of the boxes, shape (b, 4, 4).
        half: their half edge lengths, shape (b, 3) [m].
        bounds: least and greatest corner of each, shape (b, 6) [m].
        room: least distance that matters [m].

    Returns:
        Shape (b,). Boxes that are left out keep more than ``room`` from every swept capsule.
    """
    out = np.zeros(len(pose), dtype=np.bool_)
    around, box = bodies.sweeps.box, bodies.sweeps.body_box
    for s in range(len(path) - 1):
        set_stretch(bodies.hulls, path[s], path[s + 1], 0.0, 1.0)
        sweep_bodies(bodies)
        for b in range(len(pose)):
            if out[b] or are_boxes_apart(around, ZERO, bounds, b, room):
                continue
            for o in range(len(box)):
                if not are_boxes_apart(box, o, bounds, b, room):
                    strayed = deviation_bound_at_box(bodies, o, pose[b], half[b], room)
                    out[b] = out[b] or strayed != NOWHERE
    return out


@inner_kernel
def deviation_bound_where_meeting(
    bodies: SweptBodies, i: int, j: int, root: int, limit: float, enough: float
) -> float:
    """Return the deviation bound of capsules of two bodies of a robot that come closer than a limit.

    Args:
        bodies, i, j: bodies, and two of them.
        root: the joint from which they are seen.
        limit: least distance [m].
        enough: deviation beyond which the search may stop [m].

    Returns:
        The largest sum of the deviations of two such capsules [m], NOWHERE where there are none.
    """
    strayed = NOWHERE
    first, radius, moved = (
        bodies.hulls.capsule_first,
        bodies.hulls.radius,
        bodies.room.moved,
    )
    a, b = bodies.sweeps.capsule_a, bodies.sweeps.capsule_b
    for c in range(first[i], first[i + 1]):
        for d in range(first[j], first[j + 1]):
            both = moved[c, root + 1] + moved[d, root + 1]
            near = radius[c] + radius[d] + both + limit
            if segment_segment(a[c], b[c], a[d], b[d]) <= near * near:
                strayed = max(strayed, both)
                if strayed > enough:
                    return float(strayed)
    return strayed
