"""Capsules that contain everything a robot sweeps on a straight line in joint space.

Each capsule is placed at the middle of the line and its radius grown by a bound of how far any
of its points gets from there: joint by joint from the tip, a point within r of the joint's axis
(and displaced by at most m through the joints behind) moves at most (r + m) times half the
joint's travel. The bound is rigorous, so nothing between two samples goes unseen.
"""

from __future__ import annotations

import numpy as np

from planning.cell.compiled_robot import RobotKernel
from planning.kernels import inner_kernel, kernel
from planning.kinematics.chain import joint_poses
from planning.transforms import Array


@inner_kernel
def place_capsules(
    kernel: RobotKernel,
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
        kernel: the robot.
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
    joint_poses(
        kernel.placement, kernel.axis, kernel.prismatic, kernel.base, q_mid, poses
    )
    for c in range(kernel.radius.shape[0]):
        carrier = kernel.joint[c]
        for r in range(3):
            s = e = poses[carrier + 1, r, 3]
            for k in range(3):
                s += poses[carrier + 1, r, k] * kernel.start[c, k]
                e += poses[carrier + 1, r, k] * kernel.end[c, k]
            start[c, r] = s
            end[c, r] = e
        strayed = 0.0
        for j in range(carrier + 1, n + 1):
            moved[c, j] = 0.0
        for j in range(carrier, -1, -1):
            half_travel = 0.5 * abs(q_b[j] - q_a[j])
            if half_travel == 0.0 or kernel.prismatic[j]:
                strayed += half_travel
                moved[c, j] = strayed
                continue
            ax = ay = az = 0.0
            for k in range(3):
                ax += poses[j + 1, 0, k] * kernel.axis[j, k]
                ay += poses[j + 1, 1, k] * kernel.axis[j, k]
                az += poses[j + 1, 2, k] * kernel.axis[j, k]
            reach = max(
                _off_axis(start, c, poses, j + 1, ax, ay, az),
                _off_axis(end, c, poses, j + 1, ax, ay, az),
            )
            strayed += half_travel * (reach + kernel.radius[c] + strayed)
            moved[c, j] = strayed


@inner_kernel
def _off_axis(
    points: Array, c: int, poses: Array, p: int, ax: float, ay: float, az: float
) -> float:
    x = points[c, 0] - poses[p, 0, 3]
    y = points[c, 1] - poses[p, 1, 3]
    z = points[c, 2] - poses[p, 2, 3]
    cx, cy, cz = y * az - z * ay, z * ax - x * az, x * ay - y * ax
    return float(np.sqrt(cx * cx + cy * cy + cz * cz))


@kernel
def sweep_segments(
    kernel: RobotKernel, q_a: Array, q_b: Array
) -> tuple[Array, Array, Array]:
    """Return the swept capsules of many segments.

    Args:
        kernel: the robot, with what it holds in all of these segments.
        q_a, q_b: ends of the segments, shape (s, n).

    Returns:
        Capsule starts and ends, shape (s, c, 3), and grown radii, shape (s, c) [m].
    """
    count, n = q_a.shape
    c = kernel.radius.shape[0]
    start = np.empty((count, c, 3))
    end = np.empty((count, c, 3))
    radius = np.empty((count, c))
    poses = np.empty((n + 1, 4, 4))
    q_mid = np.empty(n)
    moved = np.empty((c, n + 1))
    for i in range(count):
        place_capsules(kernel, q_a[i], q_b[i], poses, q_mid, start[i], end[i], moved)
        for k in range(c):
            radius[i, k] = kernel.radius[k] + moved[k, 0]
    return start, end, radius


@kernel
def bound_travel(kernel: RobotKernel, q_a: Array, q_b: Array) -> Array:
    """Return how far any point of the robot travels in each of many segments, at most.

    Neighbours are bounded together: how far a capsule gets from a joint's axis while the
    joints are anywhere within the box of their values, times how far the joint goes.

    Args:
        kernel: the robot, with what it holds.
        q_a, q_b: ends of the segments, shape (s, n).

    Returns:
        Bounds, shape (s,) [m].
    """
    together = 8
    count, n = q_a.shape
    c = kernel.radius.shape[0]
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
        place_capsules(kernel, low, high, poses, q_mid, start, end, moved)
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
