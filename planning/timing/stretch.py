"""The quickest motion along a straight line in joint space within limits, from speed to speed."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from planning.cell.robot_model import MotionLimits
from planning.kernels import kernel
from planning.transforms import Array

_LEAST_LAG = 1e-6
"""Shortest time in which an acceleration builds up, where no jerk is too much [s]."""


@dataclass(frozen=True)
class Stretch:
    """How a straight line in joint space is passed, from rest to rest.

    It is commanded with constant acceleration, full speed and the same deceleration; what is executed
    is the mean of what was commanded during the last ``lag`` seconds. So it stays on the line, is
    never ahead of what is commanded, has a bounded jerk, and ends ``lag`` later.

    Attributes:
        cruise: time that the whole of it takes at full speed [s].
        ramp: time from rest to full speed [s].
        lag: by how much the executed motion is behind the commanded one at most [s].
    """

    cruise: float
    ramp: float
    lag: float

    @property
    def seconds(self) -> float:
        """Time from rest to rest [s]."""
        if self.cruise <= 0.0:
            return 0.0
        return from_rest_to_rest(self.cruise, self.ramp) + self.lag


def straight_stretch(
    limits: MotionLimits, way: Array, tool_speed: float = 0.0
) -> Stretch:
    """Return the quickest motion along a straight line in joint space.

    The executed acceleration is a mean of commanded ones, and changes by no more than twice the
    commanded one within ``lag``; hence ``lag`` is twice that over the limit of jerk, and a lower
    acceleration than is allowed may be the quicker one over a short way.

    Args:
        limits: of the robot.
        way: from start to end, shape (n,) [rad or m].
        tool_speed: greatest speed of the tool on the way if that took a second, over the
            limit of it [s].
    """
    found = _quickest(
        limits.velocity,
        limits.acceleration,
        limits.jerk,
        limits.sum_of_speeds,
        way,
        tool_speed,
    )
    return Stretch(*found)


def straight_seconds(limits: MotionLimits, ways: Array) -> Array:
    """Return the times from rest to rest along straight lines in joint space.

    Args:
        limits: of the robot.
        ways: from start to end, shape (..., n) [rad or m].

    Returns:
        Shape (...) [s].
    """
    rows = np.ascontiguousarray(ways, dtype=np.float64).reshape(-1, ways.shape[-1])
    seconds = _seconds(
        limits.velocity,
        limits.acceleration,
        limits.jerk,
        limits.sum_of_speeds,
        rows,
    )
    return seconds.reshape(ways.shape[:-1])


@kernel
def _seconds(
    velocity: Array,
    acceleration: Array,
    jerk: Array,
    sum_of_speeds: float,
    ways: Array,
) -> Array:
    out = np.zeros(len(ways))
    for k in range(len(ways)):
        cruise, ramp, lag = _quickest(
            velocity, acceleration, jerk, sum_of_speeds, ways[k], 0.0
        )
        if cruise > 0.0:
            out[k] = from_rest_to_rest(cruise, ramp) + lag
    return out


@kernel
def _quickest(
    velocity: Array,
    acceleration: Array,
    jerk: Array,
    sum_of_speeds: float,
    way: Array,
    cruise: float,
) -> tuple[float, float, float]:
    total = 0.0
    for i in range(len(way)):
        far = abs(way[i])
        total += far
        cruise = max(cruise, far / velocity[i])
    cruise = max(cruise, total / sum_of_speeds)
    if cruise <= 0.0:
        return 0.0, 0.0, 0.0
    least, jerky = 0.0, 0.0
    for i in range(len(way)):
        speed = abs(way[i]) / cruise
        least = max(least, speed / acceleration[i])
        # The lag is this over the ramp.
        jerky = max(jerky, 2.0 * speed / jerk[i])
    ramp, seconds = least, from_rest_to_rest(cruise, least) + jerky / least
    for other in (math.sqrt(jerky), (jerky * jerky / cruise) ** (1.0 / 3.0)):
        slower = max(least, other)
        takes = from_rest_to_rest(cruise, slower) + jerky / slower
        if takes < seconds:
            ramp, seconds = slower, takes
    return cruise, ramp, max(jerky / ramp, _LEAST_LAG)


@kernel
def from_rest_to_rest(cruise: float, ramp: float) -> float:
    """Return how long it takes from rest to rest, as commanded.

    Args:
        cruise: time of the whole way at full speed.
        ramp: time from rest to full speed.
    """
    if cruise >= ramp:
        return cruise + ramp
    return 2.0 * math.sqrt(cruise * ramp)


_ROUNDING = 1e-9
"""Share of a way by which rounding may have made a way of braking longer."""


@kernel
def exit_bound(length: Array, top: Array, node: int, last: int, ramp: Array) -> float:
    """Return the greatest speed at the end of a node from which one can stop at the end of another.

    No speed on the way is beyond what its nodes allow, either.

    Args:
        length: of each node.
        top: greatest speed in each node, at most 1.
        node: the node that is left.
        last: the node at whose end the robot has to be able to stand.
        ramp: time from rest to full speed in each node.
    """
    j, far = node + 1, 0.0
    # Beyond the way in which full speed is lost nothing counts.
    while j <= last and far < 0.5:
        far += length[j] / ramp[j]
        j += 1
    speed = 0.0 if j > last else min(top[j - 1], top[j])
    while j > node + 1:
        j -= 1
        speed = math.sqrt(speed * speed + 2.0 * length[j] / ramp[j])
        speed = min(speed, min(top[j - 1], top[j]))
    return speed


@kernel
def pass_through(
    length: float, top: float, entry: float, bound: float, ramp: float
) -> tuple[float, float, float]:
    """Return the least time through a piece of a stretch, the speed at its end and the greatest.

    Args:
        length: of the piece.
        top: greatest speed in it.
        entry: speed at its start, from which ``bound`` can be reached by braking.
        bound: greatest speed at its end.
        ramp: time from rest to full speed.
    """
    gain = 2.0 * length / ramp
    leave = min(bound, math.sqrt(entry * entry + gain))
    peak = min(top, math.sqrt(0.5 * (entry * entry + leave * leave + gain)))
    peak = max(peak, max(entry, leave))
    if peak <= 0.0:
        return 0.0, 0.0, 0.0
    speeding = (peak - entry) * ramp
    slowing = (peak - leave) * ramp
    covered = 0.5 * (speeding * (peak + entry) + slowing * (peak + leave))
    steady = max(0.0, length - covered) / peak
    return speeding + steady + slowing, leave, peak


@kernel
def braked(length: float, entry: float, ramp: float) -> tuple[float, float, float]:
    """Return how long a robot brakes within a piece, its speed then, and how far it got.

    Args:
        length: of the piece; the robot stands before its end, or leaves it at some speed.
        entry: speed at its start.
        ramp: time from full speed to rest.
    """
    way = 0.5 * entry * entry * ramp
    if way <= length * (1.0 + _ROUNDING):
        return entry * ramp, 0.0, min(way, length)
    leave = math.sqrt(max(0.0, entry * entry - 2.0 * length / ramp))
    return (entry - leave) * ramp, leave, length
