"""The quickest motion along a straight line from rest to rest: an S-curve."""

from __future__ import annotations

import math

import numpy as np

from planning.cell.motion_limits import MotionLimits
from planning.kernels import kernel
from planning.transforms import Array

_LEAST_BUILD_UP = 1e-6
"""Shortest time in which an acceleration builds up, where no jerk is too much [s]."""


def line_times(limits: MotionLimits, way: Array) -> tuple[Array, float]:
    """Return the quickest motion along a straight line in joint space, from rest to rest.

    Args:
        limits: of the robot.
        way: from start to end, not 0, shape (n,) [rad or m].

    Returns:
        How long its seven pieces take, in which the jerk is positive, 0, negative, 0, negative, 0 and
        positive, shape (7,) [s]; and that jerk over the way [1/s^3].
    """
    far = np.maximum(np.abs(way), 1e-300)
    speed = min(float(np.min(limits.velocity / far)), limits.sum_of_speeds / far.sum())
    rise = float(np.min(limits.acceleration / far))
    jolt = min(float(np.min(limits.jerk / far)), rise / _LEAST_BUILD_UP)
    build, stay, steady = s_curve_times(1.0, speed, rise, jolt)
    return np.array([build, stay, build, steady, build, stay, build]), jolt


@kernel
def s_curve_times(
    length: float, speed: float, rise: float, jolt: float
) -> tuple[float, float, float]:
    """Return the times of the pieces of an S-curve, which takes the least time that limits allow.

    The acceleration builds up, stays, and falls to 0; the speed stays; the same in reverse.

    Args:
        length: of the way, above 0.
        speed: limit of speed.
        rise: limit of acceleration.
        jolt: limit of jerk, maybe infinite.

    Returns:
        How long the acceleration builds up, how long it stays, and how long the speed stays.
    """
    build = rise / jolt
    if speed * jolt < rise * rise:
        build = math.sqrt(speed / jolt)
        stay = 0.0
    else:
        stay = speed / rise - build
    steady = length / speed - 2.0 * build - stay
    if steady >= 0.0:
        return build, stay, steady
    build = rise / jolt
    whole = 0.5 * build + math.sqrt(0.25 * build * build + length / rise)
    if whole >= 2.0 * build:
        return build, whole - 2.0 * build, 0.0
    return (0.5 * length / jolt) ** (1.0 / 3.0), 0.0, 0.0
