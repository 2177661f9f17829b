"""The quickest motion along a rounded path, as a uniform cubic spline over time.

The way along the path is an S-curve: pieces of constant jerk whose lengths are whole numbers of time
steps. Its control points are ways; the points of the curve there are control points of the motion. A
spline is in the hull of its control points, so it stays by the curve; and its speeds, accelerations
and jerks are differences of control points over powers of the time step. Hence the least step that
keeps all limits is found at once, and the best lengths of the pieces by trying.
"""

from __future__ import annotations

import math

import numpy as np

from planning.cell.motion_limits import MotionLimits
from planning.kernels import inner_kernel, kernel
from planning.timing.rounded_path import RoundedPath, curve_points
from planning.timing.s_curve import line_times
from planning.transforms import Array

_FEWEST, _MOST = 48, 512
"""Bounds of the number of time steps."""

_BUILD_UP = 4.0
"""Time steps, at least, in which an acceleration builds up."""


def curve_motion(
    limits: MotionLimits, path: RoundedPath, stray: float
) -> tuple[float, Array, Array]:
    """Return a quick motion along a rounded path from rest to rest.

    Args:
        limits: of the robot.
        path: what to follow.
        stray: farthest that the motion may leave the curve, all joints added up.

    Returns:
        The time step [s], infinite where so many steps as it would take are not offered; the ways of
        control points along the path, shape (k + 3,) for k steps; and control points,
        shape (k + 3, n).
    """
    bends = path.curvature()
    length = float(path.at[-1])
    # Nowhere twice as fast as in the mean; and in some steps accelerations build up.
    close = 2.0 * length * np.sqrt(bends.max() / (6.0 * stray))
    spans, _ = line_times(limits, np.abs(np.diff(path.corners, axis=0)).sum(axis=0))
    fine = _BUILD_UP * spans.sum() / spans[0]
    count = int(np.clip(np.ceil(max(close, fine)), _FEWEST, _MOST))
    ways, points = np.empty(count + 3), np.empty((count + 3, path.corners.shape[1]))
    step = _quickest(
        (limits.velocity, limits.acceleration, limits.jerk, limits.sum_of_speeds),
        (path.corners, path.at, path.turn, path.reach),
        (bends, stray),
        ways,
        points,
    )
    return step, ways, points


Limits = tuple[Array, Array, Array, float]
Curve = tuple[Array, Array, Array, Array]


@kernel
def _quickest(
    limits: Limits,
    curve: Curve,
    near: tuple[Array, float],
    ways: Array,
    points: Array,
) -> float:
    """Write the best control points found, and return their time step."""
    count = len(ways) - 3
    jerky = max(1, count // 12)
    steady = max(0, count // 6)
    best = _tried(limits, curve, near, jerky, steady, ways, points)
    stride = max(1, count // 8)
    while stride > 0:
        better = False
        for a, b in (
            (1, 0),
            (-1, 0),
            (0, 1),
            (0, -1),
            (1, -2),
            (-1, 2),
            (1, -1),
            (-1, 1),
        ):
            m, k = jerky + a * stride, steady + b * stride
            if m < 1 or k < 0 or 4 * m + 2 * k > count:
                continue
            step = _tried(limits, curve, near, m, k, ways, points)
            if step < best:
                best, jerky, steady, better = step, m, k, True
                break
        if not better:
            stride //= 2
    return _tried(limits, curve, near, jerky, steady, ways, points)


@inner_kernel
def _tried(
    limits: Limits,
    curve: Curve,
    near: tuple[Array, float],
    jerky: int,
    steady: int,
    ways: Array,
    points: Array,
) -> float:
    """Write the control points of an S-curve, and return their least time step.

    Args:
        limits: of speed, acceleration, jerk, and the sum of speeds.
        curve: what is followed.
        near: the curvature at its corners, and how far the motion may leave it.
        jerky: steps in which the acceleration changes, four times.
        steady: steps of constant acceleration, twice.
        ways, points: what is written.
    """
    _s_curve(jerky, steady, curve[1][-1], ways)
    curve_points(curve[0], curve[1], curve[2], curve[3], ways, points)
    least = least_step(limits, points)
    return least if _is_near(curve[1], near[0], near[1], ways) else np.inf


@inner_kernel
def _s_curve(jerky: int, steady: int, length: float, ways: Array) -> None:
    """Write the control values of an S-curve from 0 to a length."""
    count = len(ways) - 3
    ways[0] = ways[1] = ways[2] = 0.0
    rise, speed = 0.0, 0.0
    for i in range(count):
        j = min(i, count - 1 - i)
        if j < jerky:
            rise += 1.0
        elif jerky + steady <= j < 2 * jerky + steady:
            rise -= 1.0
        speed += rise
        ways[i + 3] = ways[i + 2] + speed
    scale = length / ways[count + 2]
    for i in range(count + 3):
        ways[i] = min(ways[i] * scale, length)


@inner_kernel
def least_step(limits: Limits, points: Array) -> float:
    """Return the least time step in which a spline of these control points keeps all limits."""
    velocity, acceleration, jerk, sum_of_speeds = limits
    count, n = points.shape
    speed, rise, jolt = 0.0, 0.0, 0.0
    for i in range(1, count):
        total = 0.0
        for d in range(n):
            first = points[i, d] - points[i - 1, d]
            total += abs(first)
            speed = max(speed, abs(first) / velocity[d])
            if i > 1:
                second = first - points[i - 1, d] + points[i - 2, d]
                rise = max(rise, abs(second) / acceleration[d])
                if i > 2:
                    third = second - points[i - 1, d] + 2.0 * points[i - 2, d]
                    third -= points[i - 3, d]
                    jolt = max(jolt, abs(third) / jerk[d])
        speed = max(speed, total / sum_of_speeds)
    return max(speed, max(math.sqrt(rise), math.pow(jolt, 1.0 / 3.0)))


@inner_kernel
def _is_near(at: Array, bends: Array, stray: float, ways: Array) -> bool:
    """Return whether a spline of points of a curve stays near the curve.

    It is off by half the curvature times the variance of the ways of the four control points that a
    place of it is made of, which is a third of the square of their distance at most.
    """
    piece = 0
    for i in range(len(ways) - 3):
        while piece < len(at) - 2 and ways[i] > at[piece + 1]:
            piece += 1
        bend = max(bends[piece], bends[piece + 1])
        beyond = piece + 2
        while beyond < len(at) and at[beyond - 1] < ways[i + 3]:
            bend = max(bend, bends[beyond])
            beyond += 1
        wide = max(ways[i + 1] - ways[i], ways[i + 2] - ways[i + 1])
        wide = max(wide, ways[i + 3] - ways[i + 2])
        if bend * wide * wide > 6.0 * stray * (1.0 + 1e-9):
            return False
    return True
