"""The quickest motion of a skill along its reference path within the limits of a robot.

A polyline cannot be followed at speed around its corners. At sharp ones, and wherever something
changes hands, the robot is at rest. Between these it is told to follow each straight line at
constant speed, and what it executes is the mean over a window of the mean over another one: the
first bounds accelerations, the second jerks. Industrial controllers filter their motions alike
(Biagiotti and Melchiorri, 2012). Around gentle corners that leaves the polyline, by no more than
``STRAY``: far within what collision checks allow for.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from planning.cell.motion_limits import MotionLimits
from planning.timing.stretch import straight_stretch
from planning.transforms import Array

STRAY = 1e-4
"""Farthest from the polyline around a corner that is not stopped at, all joints added up [rad or m]."""

_LEAST_WINDOW = 1e-6
"""Shortest time in which an acceleration builds up, where no jerk is too much [s]."""

_SHARP = np.radians(20.0)
"""A robot stops at corners that turn by more."""


@dataclass(frozen=True, eq=False)
class SmoothPath:
    """A motion from rest to rest: a cubic polynomial of time between two rows.

    Attributes:
        t: times of the rows, from 0, rising, shape (rows,) [s].
        q: configurations, shape (rows, n).
        v: joint speeds, shape (rows, n).
        a: accelerations, linear in time between rows, shape (rows, n).
        passed: when each waypoint of the path is passed, shape (w,) [s].
    """

    t: Array
    q: Array
    v: Array
    a: Array
    passed: Array

    @property
    def seconds(self) -> float:
        """How long the motion takes [s]."""
        return float(self.t[-1])


def smooth_path(
    limits: MotionLimits, path: Array, stops: Collection[int] = ()
) -> SmoothPath:
    """Return a quick motion along a polyline within limits.

    Any slower motion along the same curve, by a constant factor, keeps the limits as well.

    Args:
        limits: of the robot.
        path: shape (w, n).
        stops: waypoints at which the robot has to be at rest.
    """
    corners = [k for k in range(1, len(path) - 1) if k in stops or _is_sharp(path, k)]
    still = np.zeros_like(path[:1])
    t, q, v, a = [np.zeros(1)], [path[:1]], [still], [still]
    passed = np.zeros(len(path))
    now = 0.0
    for begin, end in pairwise([0, *corners, len(path) - 1]):
        for piece, (low, high) in _quicker(limits, path, begin, end):
            passed[low : high + 1] = now + piece.passed
            t.append(now + piece.t[1:])
            q.append(piece.q[1:])
            v.append(piece.v[1:])
            a.append(piece.a[1:])
            now += piece.seconds
    rows = np.concatenate(t), np.vstack(q), np.vstack(v), np.vstack(a)
    return SmoothPath(*rows, passed)


def _is_sharp(path: Array, k: int) -> bool:
    before, after = path[k] - path[k - 1], path[k + 1] - path[k]
    lengths = np.linalg.norm(before) * np.linalg.norm(after)
    if lengths <= 0.0:
        return False
    return bool(before @ after < np.cos(_SHARP) * lengths)


def _quicker(
    limits: MotionLimits, path: Array, begin: int, end: int
) -> Iterator[tuple[SmoothPath, tuple[int, int]]]:
    """Yield the quicker of two motions along gentle corners: in one go, or with a stop at each."""
    whole = _in_one_go(limits, path[begin : end + 1])
    if end - begin > 1:
        stops = list(pairwise(range(begin, end + 1)))
        parts = [_in_one_go(limits, path[a : b + 1]) for a, b in stops]
        if sum(part.seconds for part in parts) < whole.seconds:
            yield from zip(parts, stops, strict=True)
            return
    yield whole, (begin, end)


def _in_one_go(limits: MotionLimits, path: Array) -> SmoothPath:
    """Return a motion that is at rest at both ends of a polyline only."""
    ways = np.diff(path, axis=0)
    seconds = np.array([straight_stretch(limits, way).cruise for way in ways])
    moves = seconds > 0.0
    still = np.zeros_like(path[:1])
    if not moves.any():
        none = np.zeros(1)
        return SmoothPath(none, path[:1], still, still, np.zeros(len(path)))
    speed = ways[moves] / seconds[moves, None]
    steps = np.diff(np.vstack([still, speed, still]), axis=0)
    low, high = np.minimum(speed.min(axis=0), 0.0), np.maximum(speed.max(axis=0), 0.0)
    # Over any window speeds change by their range at most.
    first = float(np.max((high - low) / limits.acceleration))
    # Twice, for accelerations may change from one limit to the other at once.
    second = 2.0 * float(np.max((high - low) / first / limits.jerk))
    second = max(second, _LEAST_WINDOW)
    strays = first * float(np.max(np.abs(steps[1:-1]).sum(axis=1), initial=0.0)) / 8.0
    slower = max(1.0, np.sqrt(first / seconds.sum()), np.sqrt(strays / STRAY))
    if strays > 0.0:
        # Both windows make the way around corners; so slow that they share the allowance.
        wide = first / slower + second
        slower = max(slower, strays / first * wide / STRAY)
    return _filtered(path, steps / slower, seconds * slower, first / slower, second)


def _filtered(
    path: Array, steps: Array, seconds: Array, first: float, second: float
) -> SmoothPath:
    """Return a polyline at piecewise constant speed after two moving averages.

    Args:
        path: shape (w, n).
        steps: changes of speed at both ends and at the corners where it moves, shape (k, n).
        seconds: time from waypoint to waypoint, shape (w - 1,) [s].
        first, second: the windows [s].
    """
    arrival = np.concatenate([[0.0], np.cumsum(seconds)])
    at = np.append(arrival[:-1][seconds > 0.0], arrival[-1])
    edges = np.array([0.0, first, second, first + second])
    t = np.unique(at[:, None] + edges)
    # Rows that rounding alone keeps apart are one.
    t = t[np.append(np.diff(t) > 1e-12, True)]
    t[0] = 0.0
    since = t[:, None] - at
    q = path[0] + _ramped(since, first, second, 1) @ steps
    v = _ramped(since, first, second, 0) @ steps
    a = _ramped(since, first, second, -1) @ steps
    q[-1] = path[-1]
    v[[0, -1]] = a[[0, -1]] = 0.0
    passed = arrival + 0.5 * (first + second)
    passed[0], passed[-1] = 0.0, t[-1]
    return SmoothPath(t, q, v, a, np.maximum.accumulate(passed))


def _ramped(since: Array, first: float, second: float, integrals: int) -> Array:
    """Return a unit step after two moving averages, at times since the step.

    Args:
        since: times [s].
        first, second: the windows, above 0 [s].
        integrals: 1 for its integral, -1 for its derivative.
    """

    def power(late: float) -> Array:
        return np.asarray(np.maximum(since - late, 0.0) ** (2 + integrals))

    total = power(0.0) - power(first) - power(second) + power(first + second)
    return total / ((1.0, 2.0, 6.0)[1 + integrals] * first * second)
