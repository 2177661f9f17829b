"""A polyline whose corners are rounded: a curve with continuous curvature close to it.

Around each corner the direction changes over a length of its own, to both sides, at a rate that rises
linearly to the corner and falls linearly behind it. With x the way from the corner, h that length and
d the change of direction, that adds d (h - abs(x))^3 / (6 h^2) to the polyline. Such terms of
neighbouring corners add up: along many short lines that bend evenly, the curvature is even.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from planning.cell.robot_model import MotionLimits
from planning.kernels import inner_kernel, kernel
from planning.timing.blend import BentPieces, BlendedPath, greatest_speed
from planning.timing.path_bounds import (
    PathBounds,
    PathEfforts,
    greatest_borne_speed,
    least_ramp,
    no_efforts,
)
from planning.timing.stretch import exit_bound, pass_through
from planning.transforms import Array

_SWEEPS = 40
"""Times at most that all corners are looked at to find how far they can be rounded."""


@dataclass(frozen=True, eq=False)
class RoundedPath:
    """A curve along a polyline, by the way along that.

    Attributes:
        corners: ends and corners of the polyline, no two in a row the same, shape (w, n).
        at: way from the start to each, shape (w,).
        turn: change of direction at each corner, 0 at the ends, shape (w, n).
        reach: way before and behind each corner on which the curve leaves the polyline, shape (w,).
    """

    corners: Array
    at: Array
    turn: Array
    reach: Array

    def points(self, way: Array) -> Array:
        """Return points of the curve, shape (k, n).

        Args:
            way: of each, from 0 to the length of the polyline, rising, shape (k,).
        """
        out = np.empty((len(way), self.corners.shape[1]))
        curve_points(self.corners, self.at, self.turn, self.reach, way, out)
        return out

    def curvature(self) -> Array:
        """Return the curvature at each corner, all coordinates added up, shape (w,).

        Between two corners it is nowhere greater than at both of them.
        """
        return _curvature(self.at, np.abs(self.turn).sum(axis=1), self.reach)


def rounded_path(corners: Array, stray: float) -> RoundedPath:
    """Return a curve that is nowhere farther from a polyline than ``stray``, and has its ends.

    Args:
        corners: of the polyline with its ends, no two in a row the same, shape (w, n), w > 1.
        stray: allowance, all coordinates added up.
    """
    ways = np.diff(corners, axis=0)
    lengths = np.linalg.norm(ways, axis=1)
    at = np.concatenate([[0.0], np.cumsum(lengths)])
    turn = np.zeros_like(corners)
    turn[1:-1] = np.diff(ways / lengths[:, None], axis=0)
    reach = _reaches(at, np.abs(turn).sum(axis=1), stray)
    return RoundedPath(corners, at, turn, reach)


@kernel
def curve_points(
    corners: Array, at: Array, turn: Array, reach: Array, way: Array, out: Array
) -> None:
    """Write points of a rounded path, see ``RoundedPath.points``."""
    count, n = corners.shape
    most = reach.max()
    piece = 0
    for i in range(len(way)):
        while piece < count - 2 and way[i] > at[piece + 1]:
            piece += 1
        share = (way[i] - at[piece]) / (at[piece + 1] - at[piece])
        for d in range(n):
            gone = corners[piece + 1, d] - corners[piece, d]
            out[i, d] = corners[piece, d] + share * gone
        first = piece
        while first > 0 and way[i] - at[first] < most:
            first -= 1
        for k in range(first, count):
            if at[k] - way[i] >= most:
                break
            rest = reach[k] - abs(way[i] - at[k])
            if rest > 0.0:
                off = rest * rest * rest / (6.0 * reach[k] * reach[k])
                for d in range(n):
                    out[i, d] += off * turn[k, d]


@kernel
def _reaches(at: Array, turn: Array, stray: float) -> Array:
    """Return how far each corner is rounded to both sides.

    Between corners every term is convex, so their sum is the largest at a corner.
    """
    count = len(at)
    reach = np.zeros(count)
    for k in range(1, count - 1):
        if turn[k] > 0.0:
            beside = 2.0 * max(at[k] - at[k - 1], at[k + 1] - at[k])
            ends = min(at[k] - at[0], at[count - 1] - at[k])
            reach[k] = min(6.0 * stray / turn[k], min(beside, ends))
    for _ in range(_SWEEPS):
        found, most, done = reach.copy(), reach.max(), True
        for k in range(1, count - 1):
            far = 0.0
            for side in (-1, 1):
                j = k if side < 0 else k + 1
                while 0 < j < count - 1 and abs(at[j] - at[k]) < most:
                    rest = reach[j] - abs(at[j] - at[k])
                    if rest > 0.0:
                        far += turn[j] * rest**3 / (6.0 * reach[j] ** 2)
                    j += side
            if far <= stray * (1.0 + 1e-12):
                continue
            done = False
            for j in range(1, count - 1):
                if abs(at[j] - at[k]) < reach[j]:
                    found[j] = min(found[j], reach[j] * max(0.5, stray / far))
        if done:
            return reach
        reach = found
    for k in range(1, count - 1):
        # Corners by themselves keep to the allowance.
        reach[k] = min(reach[k], min(at[k] - at[k - 1], at[k + 1] - at[k]))
    return reach


@kernel
def _curvature(at: Array, turn: Array, reach: Array) -> Array:
    """Return the curvature at each corner; between them every term of it is convex."""
    out = np.zeros(len(at))
    for k in range(len(at)):
        for j in range(len(at)):
            rest = reach[j] - abs(at[j] - at[k])
            if rest > 0.0:
                out[k] += turn[j] * rest / (reach[j] * reach[j])
    return out


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
