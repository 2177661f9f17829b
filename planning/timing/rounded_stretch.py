"""The quickest motion along a polyline with rounded corners within limits, from rest to rest."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from planning.cell.motion_limits import MotionLimits
from planning.kernels import inner_kernel, kernel
from planning.timing.blend import BentPieces, BlendedPath, greatest_speed
from planning.timing.path_bounds import (
    PathBounds,
    PathEfforts,
    greatest_borne_speed,
    least_ramp,
    no_efforts,
)
from planning.timing.ramps import exit_bound, pass_through
from planning.transforms import Array

_LEAST_LAG = 1e-6
"""Shortest time in which an acceleration builds up, where no jerk is too much [s]."""

_SLOWER = np.array([1.0, 1.2, 1.45, 1.8, 2.3])
"""Times to full speed that are tried, over the least one."""

_SHARES = np.array([0.25, 0.4, 0.6, 0.8])
"""Shares of the rate of speed that are tried around corners; what bends the way has the rest."""


@dataclass(frozen=True, eq=False)
class RoundedStretch:
    """How a polyline with rounded corners is passed, see ``planning.timing.stretch.Stretch``.

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
    """Return the quickest motion along a polyline with rounded corners.

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
    found = _quickest(
        limits.acceleration,
        limits.jerk,
        path.velocity,
        float(path.at[-1]),
        bent,
        bounds.efforts or no_efforts(legs, bends),
        bounds.cap,
    )
    ramp, lag, bent_ramp, seconds, cap = found
    if not math.isfinite(seconds):
        return None
    low, high = bent.low - lag * cap, bent.high + lag * cap
    return RoundedStretch(ramp, lag, bent_ramp, cap, low, high, seconds)


@kernel
def _quickest(
    acceleration: Array,
    jerk: Array,
    velocity: Array,
    total: float,
    bent: BentPieces,
    efforts: PathEfforts,
    most: Array,
) -> tuple[float, float, float, float, Array]:
    """Return ramp, lag, ramp in zones, seconds and caps of the quickest that is tried."""
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
        lag = max(jerky / ramp, _LEAST_LAG)
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
                borne = greatest_borne_speed(efforts.bends, p, share / ramp)
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
    """Return the time from rest to rest as commanded."""
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
            took, speed, _ = pass_through(length[p], top[p], speed, bound, ramps[p])
            seconds += took
    return seconds
