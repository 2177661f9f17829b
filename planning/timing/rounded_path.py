"""Polylines with rounded corners: curves of continuous curvature, close to them.

Skills follow a *rounded path*. Around each corner the direction changes over a length of its own, to both
sides, at a rate that rises linearly to the corner and falls linearly behind it. With x the way from the
corner, h that length and d the change of direction, that adds d (h - abs(x))^3 / (6 h^2) to the polyline.
Such terms of neighbouring corners add up: along many short lines that bend evenly, the curvature is even.

Transits follow a *blended path*: a polyline at the full speed of each leg, and at each corner the velocity
goes from that of the one leg to that of the other over a window of time, half of it before the corner. The
acceleration rises, stays and falls meanwhile. Windows may overlap, where legs are short; as long as
they begin and end in the order of the corners, the velocity is a mean of those of the legs, so no
joint is faster than on all of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from planning.cell.motion_limits import MotionLimits
from planning.kernels import kernel
from planning.timing.path_bounds import HEAD_ROOM
from planning.transforms import Array

STRAY = 1e-4
"""Farthest of a motion from the polyline, or from chords, that are checked in its place, all joints
added up [rad or m]."""

_SWEEPS = 40
"""Times at most that all corners are looked at to find how far they can be rounded."""

_RISE = 0.2
"""Share of a window in which the acceleration rises, and in which it falls."""

_BENT = 0.8
"""Share of the acceleration for bending the path where nothing keeps a robot from full speed."""

_SHORTEST = 1e-9
"""What is between two breaks that are nearer than that is nothing [s]."""


@dataclass(frozen=True, eq=False)
class RoundedPath:
    """A curve near a polyline, parametrised by arc length along that polyline.

    Attributes:
        corners: ends and corners of the polyline, no two in a row the same, shape (w, n).
        at: arc length from the start to each, shape (w,).
        turn: change of direction at each corner, 0 at the ends, shape (w, n).
        reach: arc length before and after each corner on which the curve leaves the polyline, shape (w,).
    """

    corners: Array
    at: Array
    turn: Array
    reach: Array

    def points(self, arc: Array) -> Array:
        """Return points of the curve, shape (k, n).

        Args:
            arc: of each, from 0 to the length of the polyline, rising, shape (k,).
        """
        out = np.empty((len(arc), self.corners.shape[1]))
        curve_points(self.corners, self.at, self.turn, self.reach, arc, out)
        return out

    def curvature(self) -> Array:
        """Return the curvature at each corner, summed over all coordinates, shape (w,).

        Between two corners it is nowhere greater than at both of them.
        """
        return _curvature(self.at, np.abs(self.turn).sum(axis=1), self.reach)


def rounded_path(corners: Array, stray: float) -> RoundedPath:
    """Return a curve that deviates at most ``stray`` from a polyline, and has its ends.

    Args:
        corners: of the polyline with its ends, no two in a row the same, shape (w, n), w > 1.
        stray: allowed deviation, summed over all coordinates.
    """
    steps = np.diff(corners, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    at = np.concatenate([[0.0], np.cumsum(lengths)])
    turn = np.zeros_like(corners)
    turn[1:-1] = np.diff(steps / lengths[:, None], axis=0)
    reach = _reaches(at, np.abs(turn).sum(axis=1), stray)
    return RoundedPath(corners, at, turn, reach)


@kernel
def curve_points(
    corners: Array, at: Array, turn: Array, reach: Array, arc: Array, out: Array
) -> None:
    """Write points of a rounded path, see ``RoundedPath.points``."""
    count, n = corners.shape
    most = reach.max()
    piece = 0
    for i in range(len(arc)):
        while piece < count - 2 and arc[i] > at[piece + 1]:
            piece += 1
        share = (arc[i] - at[piece]) / (at[piece + 1] - at[piece])
        for d in range(n):
            gone = corners[piece + 1, d] - corners[piece, d]
            out[i, d] = corners[piece, d] + share * gone
        first = piece
        while first > 0 and arc[i] - at[first] < most:
            first -= 1
        for k in range(first, count):
            if at[k] - arc[i] >= most:
                break
            rest = reach[k] - abs(arc[i] - at[k])
            if rest > 0.0:
                off = rest * rest * rest / (6.0 * reach[k] * reach[k])
                for d in range(n):
                    out[i, d] += off * turn[k, d]


@kernel
def _reaches(at: Array, turn: Array, stray: float) -> Array:
    """Return the extent of the rounding on both sides of each corner.

    Between corners every term is convex, so their sum is the largest at a corner.
    """
    count = len(at)
    reach = np.zeros(count)
    for k in range(1, count - 1):
        if turn[k] > 0.0:
            adjacent = 2.0 * max(at[k] - at[k - 1], at[k + 1] - at[k])
            ends = min(at[k] - at[0], at[count - 1] - at[k])
            reach[k] = min(6.0 * stray / turn[k], min(adjacent, ends))
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


class BentPieces(NamedTuple):
    """Pieces of a blended path on which the third derivative is constant, and bounds on each.

    Attributes:
        low, high: where they begin and end, shape (p,) [s].
        first, second, third: bounds of the derivatives of each joint, shape (p, n).
    """

    low: Array
    high: Array
    first: Array
    second: Array
    third: Array


@dataclass(frozen=True, eq=False)
class BlendedPath:
    """A polyline at full speed with blended corners; its parameter is time at full speed [s].

    Attributes:
        at: of the start, the corners and the end, rising, shape (k + 2,) [s].
        points: the start, the corners and the end, shape (k + 2, n).
        window: over which the velocity changes at each corner, half of it before the corner, shape
            (k,) [s].
    """

    at: Array
    points: Array
    window: Array

    @property
    def velocity(self) -> Array:
        """Full speed on each leg, shape (k + 1, n)."""
        return np.asarray(np.diff(self.points, axis=0) / np.diff(self.at)[:, None])

    def states(self, arc: Array) -> tuple[Array, Array, Array]:
        """Return configurations at parameter values, and their first and second derivatives.

        Args:
            arc: shape (w,) [s].

        Returns:
            Three arrays of shape (w, n).
        """
        speed = self.velocity
        leg = np.clip(
            np.searchsorted(self.at, arc, side="right") - 1, 0, len(speed) - 1
        )
        q = self.points[leg] + (arc - self.at[leg])[:, None] * speed[leg]
        first, second = speed[leg], np.zeros_like(q)
        for k, window in enumerate(self.window.tolist()):
            since = (arc - self.at[k + 1]) / window
            inside = np.flatnonzero(np.abs(since) < 0.5)
            x, turn = since[inside, None], speed[k + 1] - speed[k]
            q[inside] += window * (_averaged(x, 1) - np.maximum(x, 0.0)) * turn
            first[inside] += (_averaged(x, 0) - (x >= 0.0)) * turn
            second[inside] += _averaged(x, -1) / window * turn
        return q, first, second

    def breaks(self) -> Array:
        """Return the parameter values at which the third derivative changes, rising."""
        edges = np.array([-0.5, _RISE - 0.5, 0.5 - _RISE, 0.5])
        return np.unique(self.at[1:-1, None] + self.window[:, None] * edges)

    def bent_pieces(self) -> BentPieces:
        """Return the pieces of the path that are not straight."""
        breaks = self.breaks()
        _, first, second = self.states(breaks)
        low, high = breaks[:-1], breaks[1:]
        span = (high - low)[:, None]
        step = np.abs(np.diff(second, axis=0))
        first, second = np.abs(first), np.abs(second)
        left, right = self.at[1:-1] - self.window / 2, self.at[1:-1] + self.window / 2
        middle = 0.5 * (low + high)[:, None]
        bent = np.any((middle > left) & (middle < right), axis=1)
        kept = bent & (span[:, 0] > _SHORTEST)
        return BentPieces(
            low[kept],
            high[kept],
            # Between its ends a quadratic is that near to its chord.
            (np.maximum(first[1:], first[:-1]) + step * span / 8.0)[kept],
            np.maximum(second[1:], second[:-1])[kept],
            (step[kept] / span[kept]),
        )

    def chords(self, low: float, high: float) -> int:
        """Return the number of chords, equal in time, that stay within STRAY of a part of the path."""
        _, _, second = self.states(self.breaks())
        bend = float(np.max(np.abs(second).sum(axis=1), initial=0.0))
        return max(2, int(np.ceil((high - low) * np.sqrt(bend / (8.0 * STRAY)))))


def _averaged(x: Array, integrals: int) -> Array:
    """Return a unit step after two moving averages: 1 for its integral, -1 for its derivative.

    Args:
        x: windows since the middle.
        integrals: -1, 0 or 1.
    """

    def power(late: float) -> Array:
        return np.asarray(np.maximum(x + 0.5 - late, 0.0) ** (2 + integrals))

    total = power(0.0) - power(_RISE) - power(1.0 - _RISE) + power(1.0)
    scale = (1.0, 2.0, 6.0)[1 + integrals] * _RISE * (1.0 - _RISE)
    return np.asarray(total / scale)


def longest_window(limits: MotionLimits, turn: Array) -> float:
    """Return the window at which a corner may be passed at full speed, ignoring jerk [s].

    Args:
        limits: of the robot.
        turn: by how much the full speed changes at the corner, shape (n,).
    """
    bent = np.abs(turn) / (_BENT * HEAD_ROOM * limits.acceleration)
    return float(np.max(bent)) / (1.0 - _RISE)


def ordered_windows(at: Array, window: Array, low: float, high: float) -> Array:
    """Return the longest windows that begin and end in the order of their corners.

    Args:
        at: path parameters of the corners, rising, shape (k,) [s].
        window: none is longer than that, shape (k,) [s].
        low, high: none begins before or ends after that [s].
    """
    half = np.minimum(0.5 * window, np.minimum(at - low, high - at))
    for k in range(1, len(at)):
        half[k] = min(half[k], half[k - 1] + at[k] - at[k - 1])
    for k in range(len(at) - 2, -1, -1):
        half[k] = min(half[k], half[k + 1] + at[k + 1] - at[k])
    return np.asarray(2.0 * half)
