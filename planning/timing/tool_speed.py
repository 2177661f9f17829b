"""Upper bound of the speed of a tool point along a motion.

The squared speed is sampled every ``h`` seconds. Between two samples it exceeds the larger one by at most the
bound of its second derivative times ``h * h / 8``. This bound follows from the first three time derivatives of the
position, which are bounded by the joint motions and the link lengths. Enough samples are taken to make it small.
"""

from __future__ import annotations

import math

import numpy as np

from planning.kernels import inner_kernel, kernel
from planning.kinematics.chain import JointTable, joint_axis, pose_joints
from planning.transforms import Array

_COARSE = 4
"""Samples of each piece of a motion in the first look."""

_ADDED = 0.002
"""Share of the greatest square of a speed that the bound between samples may add."""

_MOST_SAMPLES = 2048
"""Samples of each piece of a motion at most; beyond them the bound adds more."""


def greatest_tool_speed(
    joints: JointTable, tip: Array, t: Array, q: Array, v: Array, a: Array
) -> float:
    """Return an upper bound of the tool point's speed, within 0.1 % of the greatest [m/s].

    Args:
        joints: of the robot.
        tip: the point in the last joint's frame, shape (3,) [m].
        t: times of rows, rising, shape (rows,) [s].
        q: configurations, cubic in time between rows, shape (rows, n).
        v: joint speeds, likewise.
        a: accelerations, linear in time between rows, likewise.
    """
    # Writable copies: numba recompiles for read-only arrays.
    rows = [np.array(x, dtype=np.float64) for x in (tip, t, q, v, a)]
    return math.sqrt(_greatest_square(joints, *rows))


def tool_speed_along(
    joints: JointTable, tip: Array, start: Array, displacement: Array
) -> float:
    """Return such a bound along a straight line in joint space that is passed in one second [m/s].

    Args:
        joints: of the robot.
        tip: the point in the last joint's frame, shape (3,) [m].
        start: where the line begins, shape (n,).
        displacement: from there to its end, shape (n,).
    """
    still = np.zeros((2, len(displacement)))
    q, v = (
        np.array([start, start + displacement]),
        np.array([displacement, displacement]),
    )
    return greatest_tool_speed(joints, tip, np.array([0.0, 1.0]), q, v, still)


@kernel
def _greatest_square(
    joints: JointTable, tip: Array, t: Array, q: Array, v: Array, a: Array
) -> float:
    n = q.shape[1]
    poses = np.empty((n + 1, 4, 4))
    point, rate = np.empty(n), np.empty(n)
    most = 0.0
    for k in range(len(t) - 1):
        for i in range(_COARSE + 1):
            _state(t, q, v, a, k, i / _COARSE, point, rate)
            most = max(most, _square(joints, tip, point, rate, poses))
    if most <= 0.0:
        # A point on the axis of the one joint that turns; it may leave it if others do.
        most = 1e-18
    greatest = 0.0
    for k in range(len(t) - 1):
        h = t[k + 1] - t[k]
        bend = _bend(joints, tip, h, q, v, a, k) * h * h / 8.0
        count = int(
            min(max(_COARSE, np.ceil(np.sqrt(bend / (_ADDED * most)))), _MOST_SAMPLES)
        )
        own = 0.0
        for i in range(count + 1):
            _state(t, q, v, a, k, i / count, point, rate)
            own = max(own, _square(joints, tip, point, rate, poses))
        greatest = max(greatest, own + bend / (count * count))
    return greatest


@inner_kernel
def _state(
    t: Array,
    q: Array,
    v: Array,
    a: Array,
    k: int,
    share: float,
    point: Array,
    rate: Array,
) -> None:
    """Write the joint values and speeds at a fraction of a piece."""
    h = t[k + 1] - t[k]
    s = share * h
    for j in range(q.shape[1]):
        jerk = (a[k + 1, j] - a[k, j]) / h
        point[j] = q[k, j] + s * (v[k, j] + s * (a[k, j] / 2.0 + s * jerk / 6.0))
        rate[j] = v[k, j] + s * (a[k, j] + s * jerk / 2.0)


@inner_kernel
def _square(
    joints: JointTable, tip: Array, point: Array, rate: Array, poses: Array
) -> float:
    """Return the squared speed of the tip."""
    pose_joints(joints, point, poses)
    n = len(point)
    last = poses[n]
    x = last[0, 0] * tip[0] + last[0, 1] * tip[1] + last[0, 2] * tip[2] + last[0, 3]
    y = last[1, 0] * tip[0] + last[1, 1] * tip[1] + last[1, 2] * tip[2] + last[1, 3]
    z = last[2, 0] * tip[0] + last[2, 1] * tip[1] + last[2, 2] * tip[2] + last[2, 3]
    vx, vy, vz = 0.0, 0.0, 0.0
    for j in range(n):
        ax, ay, az = joint_axis(joints, poses, j)
        if joints.prismatic[j]:
            dx, dy, dz = ax, ay, az
        else:
            rx = x - poses[j + 1, 0, 3]
            ry = y - poses[j + 1, 1, 3]
            rz = z - poses[j + 1, 2, 3]
            dx, dy, dz = ay * rz - az * ry, az * rx - ax * rz, ax * ry - ay * rx
        vx += rate[j] * dx
        vy += rate[j] * dy
        vz += rate[j] * dz
    return vx * vx + vy * vy + vz * vz


@inner_kernel
def _bend(
    joints: JointTable, tip: Array, h: float, q: Array, v: Array, a: Array, k: int
) -> float:
    """Return a bound of the second derivative of the squared tip speed within a piece.

    A vector of constant length that joints turn changes no faster than their rates add up to; one
    along a joint that slides changes in length as well.
    """
    n = q.shape[1]
    placement = joints.placement
    turn, turn2, turn3 = 0.0, 0.0, 0.0
    first, second, third = 0.0, 0.0, 0.0
    for j in range(n):
        jerk = abs(a[k + 1, j] - a[k, j]) / h
        fast = max(abs(v[k, j]), abs(v[k + 1, j])) + jerk * h * h / 8.0
        quick = max(abs(a[k, j]), abs(a[k + 1, j]))
        if joints.prismatic[j]:
            # Turned by the joints before it, and longer or shorter by its own motion.
            far = max(abs(q[k, j]), abs(q[k + 1, j])) + fast * h
            one, two, three = _turned(turn, turn2, turn3)
            first += one * far + fast
            second += two * far + 2.0 * one * fast + quick
            third += three * far + 3.0 * two * fast + 3.0 * one * quick + jerk
        else:
            turn += fast
            turn2 += quick
            turn3 += jerk
        if j + 1 < n:
            x, y, z = (
                placement[j + 1, 0, 3],
                placement[j + 1, 1, 3],
                placement[j + 1, 2, 3],
            )
        else:
            x, y, z = tip[0], tip[1], tip[2]
        length = np.sqrt(x * x + y * y + z * z)
        one, two, three = _turned(turn, turn2, turn3)
        first += one * length
        second += two * length
        third += three * length
    return 2.0 * (second * second + first * third)


@inner_kernel
def _turned(turn: float, turn2: float, turn3: float) -> tuple[float, float, float]:
    """Return bounds of three derivatives of a unit vector rotated at given rates."""
    two = turn * turn + turn2
    return turn, two, turn * turn * turn + 3.0 * turn * turn2 + turn3
