"""Blended paths: polylines with constant speed on each line segment and smooth velocity changes at the corners.

Transits follow blended paths. A robot passes each line segment at full speed. At a corner, its velocity changes from
that of one segment to that of the next within a time window, half of it before the corner. In this window the
acceleration rises, stays constant and falls. Windows of short segments may overlap. If they begin and end in the
order of the corners, the velocity is a weighted mean of the velocities of the segments, so no joint exceeds its
greatest speed on these segments.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from planning.cell.motion_limits import MotionLimits
from planning.timing.path_bounds import HEAD_ROOM
from planning.transforms import Array

STRAY = 1e-4
"""Farthest of a motion from the polyline, or from chords, that are checked in its place, all joints
added up [rad or m]."""

_RISE = 0.2
"""Share of a window in which the acceleration rises, and in which it falls."""

_BENT = 0.8
"""Share of the acceleration for bending the path where nothing keeps a robot from full speed."""

_SHORTEST = 1e-9
"""What is between two breaks that are nearer than that is nothing [s]."""


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
