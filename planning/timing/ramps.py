"""Speeds at the borders of nodes, such that a robot can always stop where it may not go on.

Along a stretch, lengths are times at full speed, so that full speed is 1; ``ramp`` is the time from
rest to it, so acceleration is at most 1 / ramp; around rounded corners it is longer than elsewhere. All times are in one unit, nanoseconds in the engines.
Both engines call these functions with the same numbers, hence get the same times.
"""

from __future__ import annotations

import math

from planning.kernels import kernel
from planning.transforms import Array

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
