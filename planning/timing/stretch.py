"""Fastest motion from rest to rest along a stretch within limits, and from speed to speed in its parts.

A stretch is a straight line in joint space, or a polyline with rounded corners.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from planning.cell.motion_limits import MotionLimits
from planning.kernels import inner_kernel, kernel
from planning.timing.path_bounds import (
    HEAD_ROOM,
    PathBounds,
    PathEfforts,
    least_ramp,
    torque_limited_speed,
    unlimited_efforts,
)
from planning.timing.rounded_path import BentPieces, BlendedPath
from planning.transforms import Array

LEAST_BUILD_UP = 1e-6
"""Shortest time in which an acceleration builds up, where no jerk is too much [s]."""

_ROUNDING = 1e-9
"""Relative rounding error allowed in a braking distance."""

_HALVINGS = 48

_SLOWER = np.array([1.0, 1.2, 1.45, 1.8, 2.3])
"""Times to full speed that are tried, over the least one."""

_SHARES = np.array([0.25, 0.4, 0.6, 0.8])
"""Shares of the rate of speed that are tried around corners; what bends the way has the rest."""


@dataclass(frozen=True)
class Stretch:
    """Timing of a straight line in joint space, from rest to rest.

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
        return rest_to_rest_seconds(self.cruise, self.ramp) + self.lag


def straight_stretch(
    limits: MotionLimits, displacement: Array, tool_speed: float = 0.0
) -> Stretch:
    """Return the fastest motion along a straight line in joint space.

    The executed acceleration is a mean of commanded ones, and changes by no more than twice the
    commanded one within ``lag``; hence ``lag`` is twice that over the limit of jerk, and a lower
    acceleration than is allowed may be the quicker one over a short way.

    Args:
        limits: of the robot.
        displacement: from start to end, shape (n,) [rad or m].
        tool_speed: greatest speed of the tool on the way if that took a second, over the
            limit of it [s].
    """
    found = _quickest_straight(
        limits.velocity,
        limits.acceleration,
        limits.jerk,
        limits.sum_of_speeds,
        displacement,
        tool_speed,
    )
    return Stretch(*found)


def straight_seconds(limits: MotionLimits, displacements: Array) -> Array:
    """Return the times from rest to rest along straight lines in joint space.

    Args:
        limits: of the robot.
        displacements: displacements from start to end, shape (..., n) [rad or m].

    Returns:
        Shape (...) [s].
    """
    rows = np.ascontiguousarray(displacements, dtype=np.float64).reshape(
        -1, displacements.shape[-1]
    )
    seconds = _seconds(
        limits.velocity,
        limits.acceleration,
        limits.jerk,
        limits.sum_of_speeds,
        rows,
    )
    return seconds.reshape(displacements.shape[:-1])


@kernel
def _seconds(
    velocity: Array,
    acceleration: Array,
    jerk: Array,
    sum_of_speeds: float,
    displacements: Array,
) -> Array:
    out = np.zeros(len(displacements))
    for k in range(len(displacements)):
        cruise, ramp, lag = _quickest_straight(
            velocity, acceleration, jerk, sum_of_speeds, displacements[k], 0.0
        )
        if cruise > 0.0:
            out[k] = rest_to_rest_seconds(cruise, ramp) + lag
    return out


@kernel
def _quickest_straight(
    velocity: Array,
    acceleration: Array,
    jerk: Array,
    sum_of_speeds: float,
    displacement: Array,
    cruise: float,
) -> tuple[float, float, float]:
    total = 0.0
    for i in range(len(displacement)):
        far = abs(displacement[i])
        total += far
        cruise = max(cruise, far / velocity[i])
    cruise = max(cruise, total / sum_of_speeds)
    if cruise <= 0.0:
        return 0.0, 0.0, 0.0
    least, jerky = 0.0, 0.0
    for i in range(len(displacement)):
        speed = abs(displacement[i]) / cruise
        least = max(least, speed / acceleration[i])
        # The lag is this over the ramp.
        jerky = max(jerky, 2.0 * speed / jerk[i])
    ramp, seconds = least, rest_to_rest_seconds(cruise, least) + jerky / least
    for other in (math.sqrt(jerky), (jerky * jerky / cruise) ** (1.0 / 3.0)):
        slower = max(least, other)
        takes = rest_to_rest_seconds(cruise, slower) + jerky / slower
        if takes < seconds:
            ramp, seconds = slower, takes
    return cruise, ramp, max(jerky / ramp, LEAST_BUILD_UP)


@kernel
def rest_to_rest_seconds(cruise: float, ramp: float) -> float:
    """Return the commanded time from rest to rest.

    Args:
        cruise: time of the whole stretch at full speed.
        ramp: time from rest to full speed.
    """
    if cruise >= ramp:
        return cruise + ramp
    return 2.0 * math.sqrt(cruise * ramp)


@kernel
def exit_bound(length: Array, top: Array, node: int, last: int, ramp: Array) -> float:
    """Return the greatest speed at the end of a node that still allows a stop at the end of another.

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
def passage_seconds(
    length: float, top: float, entry: float, bound: float, ramp: float
) -> tuple[float, float, float]:
    """Return the least time through a piece of a stretch, its exit speed and its greatest speed.

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
def brake_within_piece(
    length: float, entry: float, ramp: float
) -> tuple[float, float, float]:
    """Return the braking time of a robot within a piece, its speed then, and its progress.

    Args:
        length: of the piece; the robot stands before its end, or leaves it at some speed.
        entry: speed at its start.
        ramp: time from full speed to rest.
    """
    displacement = 0.5 * entry * entry * ramp
    if displacement <= length * (1.0 + _ROUNDING):
        return entry * ramp, 0.0, min(displacement, length)
    leave = math.sqrt(max(0.0, entry * entry - 2.0 * length / ramp))
    return (entry - leave) * ramp, leave, length


@dataclass(frozen=True, eq=False)
class RoundedStretch:
    """Timing of a polyline with rounded corners, see ``Stretch``.

    What is executed is the mean of what was commanded in the last ``lag`` seconds, so limits of a
    bent piece hold a little before and after it: in its *zone*.

    Attributes:
        ramp: time from rest to full speed elsewhere [s].
        lag: by how much the executed motion is behind the commanded one at most [s].
        bent_ramp: time from rest to full speed in zones [s].
        cap: greatest share of full speed in each zone, shape (p,).
        low, high: where zones begin and end, shape (p,) [s].
        seconds: time from rest to rest [s].
    """

    ramp: float
    lag: float
    bent_ramp: float
    cap: Array
    low: Array
    high: Array
    seconds: float


def rounded_stretch(
    limits: MotionLimits, path: BlendedPath, bounds: PathBounds | None = None
) -> RoundedStretch | None:
    """Return the fastest motion along a polyline with rounded corners.

    Args:
        limits: of the robot.
        path: the polyline; no leg is faster than joints and the tool may be.
        bounds: what else it keeps to.

    Returns:
        None where some corner cannot be passed at any speed.
    """
    bent = path.bent_pieces()
    legs, bends = len(path.at) - 1, len(bent.low)
    if bounds is None:
        bounds = PathBounds(np.ones(bends))
    found = _quickest_rounded(
        limits.acceleration,
        limits.jerk,
        path.velocity,
        float(path.at[-1]),
        bent,
        bounds.efforts or unlimited_efforts(legs, bends),
        bounds.cap,
    )
    ramp, lag, bent_ramp, seconds, cap = found
    if not math.isfinite(seconds):
        return None
    low, high = bent.low - lag * cap, bent.high + lag * cap
    return RoundedStretch(ramp, lag, bent_ramp, cap, low, high, seconds)


@kernel
def _quickest_rounded(
    acceleration: Array,
    jerk: Array,
    velocity: Array,
    total: float,
    bent: BentPieces,
    efforts: PathEfforts,
    most: Array,
) -> tuple[float, float, float, float, Array]:
    """Return ramp, lag, ramp in zones, seconds and caps of the fastest trial."""
    count = len(bent.low)
    least, jerky = least_ramp(efforts.legs), 0.0
    for leg in range(len(velocity)):
        for i in range(len(acceleration)):
            speed = abs(velocity[leg, i])
            least = max(least, speed / acceleration[i])
            jerky = max(jerky, 2.0 * speed / jerk[i])
    best_ramp, best_lag, best_bent, best = least, 0.0, least, math.inf
    best_cap, cap = np.zeros(count), np.zeros(count)
    if not math.isfinite(least):
        return best_ramp, best_lag, best_bent, best, best_cap
    for slower in _SLOWER:
        ramp = least * slower
        lag = max(jerky / ramp, LEAST_BUILD_UP)
        for share in _SHARES:
            slowest = 1.0
            for p in range(count):
                by_joints = greatest_speed(
                    acceleration,
                    jerk,
                    bent.first[p],
                    bent.second[p],
                    bent.third[p],
                    share / ramp,
                    lag,
                )
                borne = torque_limited_speed(efforts.bends, p, share / ramp)
                cap[p] = min(min(by_joints, borne), most[p])
                slowest = min(slowest, cap[p])
            if slowest <= 0.0:
                continue
            seconds = lag + _commanded(total, bent, cap, ramp, ramp / share, lag)
            if seconds < best:
                best_ramp, best_lag, best_bent, best = ramp, lag, ramp / share, seconds
                best_cap[:] = cap
    return best_ramp, best_lag, best_bent, best, best_cap


@inner_kernel
def _commanded(
    total: float,
    bent: BentPieces,
    cap: Array,
    ramp: float,
    bent_ramp: float,
    lag: float,
) -> float:
    """Return the commanded time from rest to rest."""
    count = len(cap)
    edges = np.empty(2 * count + 2)
    edges[0], edges[1] = 0.0, total
    for k in range(count):
        reach = lag * cap[k]
        edges[2 * k + 2] = min(max(bent.low[k] - reach, 0.0), total)
        edges[2 * k + 3] = min(max(bent.high[k] + reach, 0.0), total)
    edges.sort()
    pieces = len(edges) - 1
    length, top, ramps = np.empty(pieces), np.ones(pieces), np.full(pieces, ramp)
    for p in range(pieces):
        length[p] = edges[p + 1] - edges[p]
        middle = 0.5 * (edges[p] + edges[p + 1])
        for k in range(count):
            reach = lag * cap[k]
            if bent.low[k] - reach < middle < bent.high[k] + reach:
                top[p] = min(top[p], cap[k])
                ramps[p] = bent_ramp
    seconds, speed = 0.0, 0.0
    for p in range(pieces):
        if length[p] > 0.0:
            bound = exit_bound(length, top, p, pieces - 1, ramps)
            took, speed, _ = passage_seconds(length[p], top[p], speed, bound, ramps[p])
            seconds += took
    return seconds


@kernel
def greatest_speed(
    acceleration: Array,
    jerk: Array,
    first: Array,
    second: Array,
    third: Array,
    rate: float,
    lag: float,
) -> float:
    """Return the greatest share of full speed on a bent piece, 0 for none.

    Of s the way and q(s) the curve, joints have accelerations q' s'' + q'' s'^2 and jerks
    q' s''' + 3 q'' s' s'' + q''' s'^3. Bounds of the terms are added up.

    Args:
        acceleration, jerk: limits of the joints, shape (n,).
        first, second, third: bounds of the derivatives, shape (n,).
        rate: most that the share of full speed changes in a second there [1/s].
        lag: time over which what is commanded is averaged [s].
    """
    greatest = 1.0
    for i in range(len(first)):
        spare = HEAD_ROOM * acceleration[i] - first[i] * rate
        spare_jerk = HEAD_ROOM * jerk[i] - first[i] * (2.0 * rate / lag)
        if spare < 0.0 or spare_jerk < 0.0:
            return 0.0
        if second[i] * greatest * greatest > spare:
            greatest = math.sqrt(spare / second[i])
        bent = 3.0 * second[i] * rate
        if (third[i] * greatest * greatest + bent) * greatest > spare_jerk:
            low, high = 0.0, greatest
            for _ in range(_HALVINGS):
                middle = 0.5 * (low + high)
                if (third[i] * middle * middle + bent) * middle > spare_jerk:
                    high = middle
                else:
                    low = middle
            greatest = low
    return greatest
