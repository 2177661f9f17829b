"""The quickest motion of a skill along its reference path within the limits of a robot.

A polyline cannot be followed at speed around its corners. At sharp ones, and wherever something
changes hands, the robot is at rest. In between, gentle corners are rounded, within ``STRAY`` of the
polyline, which is far within what collision checks allow for, and the curve is passed in an S-curve over
time: its speed rises, stays and falls with bounded jerk. Where a stop at a corner is quicker, it stops.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from planning.cell.motion_limits import MotionLimits
from planning.timing.curve_times import curve_motion
from planning.timing.rounded_path import rounded_path
from planning.timing.s_curve import line_times
from planning.transforms import Array

STRAY = 1e-4
"""Farthest from the polyline around a corner that is not stopped at, all joints added up [rad or m]."""

_ROUNDED = 0.8
"""Share of it for rounding corners; the rest is for following the curve."""

_SHARP = np.radians(20.0)
"""A robot stops at corners that turn by more."""

_SAME = 1e-12
"""Waypoints nearer to each other are one [rad or m]."""


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
    lengths = np.linalg.norm(np.diff(path, axis=0), axis=1)
    moved = np.append(True, lengths > _SAME)
    # The last waypoint counts, not one before it that is the same.
    corner = np.cumsum(moved) - 1
    points = path[np.append(np.flatnonzero(moved)[1:] - 1, len(path) - 1)]
    rests = {int(corner[k]) for k in stops}
    ends = [0, *_rests(points, rests), *([len(points) - 1] if len(points) > 1 else [])]
    still = np.zeros_like(path[:1])
    t, q, v, a = [np.zeros(1)], [points[:1]], [still], [still]
    passed = np.zeros(len(points))
    now = 0.0
    for begin, end in pairwise(ends):
        for low, high, piece in _quickest(limits, points, begin, end):
            passed[low : high + 1] = now + piece.passed
            t.append(now + piece.t[1:])
            q.append(piece.q[1:])
            v.append(piece.v[1:])
            a.append(piece.a[1:])
            now += piece.seconds
    rows = np.concatenate(t), np.vstack(q), np.vstack(v), np.vstack(a)
    return SmoothPath(*rows, passed[corner])


def _rests(points: Array, stops: Collection[int]) -> list[int]:
    """Return the corners between the ends at which a robot has to be at rest."""
    ways = np.diff(points, axis=0)
    unit = ways / np.linalg.norm(ways, axis=1)[:, None]
    sharp = np.sum(unit[1:] * unit[:-1], axis=1) < np.cos(_SHARP)
    return [k for k in range(1, len(points) - 1) if sharp[k - 1] or k in stops]


def _quickest(
    limits: MotionLimits, points: Array, begin: int, end: int
) -> Iterator[tuple[int, int, SmoothPath]]:
    """Yield motions from rest to rest between gentle corners of a polyline, with their ends.

    They are one, or more where stops at the sharpest corners save time.
    """
    whole = _in_one_go(limits, points[begin : end + 1])
    if end - begin > 1:
        ways = np.diff(points[begin : end + 1], axis=0)
        unit = ways / np.linalg.norm(ways, axis=1)[:, None]
        middle = begin + 1 + int(np.argmin(np.sum(unit[1:] * unit[:-1], axis=1)))
        sides = np.array_split(ways, [middle - begin])
        # Along the straight lines to the corner and from it the parts do not take much longer.
        least = sum(
            float(line_times(limits, side.sum(axis=0))[0].sum()) for side in sides
        )
        if whole is None or least < whole.seconds:
            parts = [
                *_quickest(limits, points, begin, middle),
                *_quickest(limits, points, middle, end),
            ]
            if whole is None or sum(p.seconds for *_, p in parts) < whole.seconds:
                yield from parts
                return
    assert whole is not None
    yield begin, end, whole


def _in_one_go(limits: MotionLimits, points: Array) -> SmoothPath | None:
    """Return a motion that is at rest at both ends only, None where it would take too many rows."""
    if len(points) == 2:
        return _on_a_line(limits, points)
    path = rounded_path(points, _ROUNDED * STRAY)
    step, ways, control = curve_motion(limits, path, (1.0 - _ROUNDED) * STRAY)
    if not np.isfinite(step):
        return None
    t = step * np.arange(len(ways) - 2, dtype=np.float64)
    before, at, after = control[:-2], control[1:-1], control[2:]
    q = (before + 4.0 * at + after) / 6.0
    q[0], q[-1] = points[0], points[-1]
    v = (after - before) / (2.0 * step)
    a = (after - 2.0 * at + before) / step**2
    gone = (ways[:-2] + 4.0 * ways[1:-1] + ways[2:]) / 6.0
    passed = np.interp(path.at, gone, t)
    passed[0], passed[-1] = 0.0, t[-1]
    return SmoothPath(t, q, v, a, passed)


def _on_a_line(limits: MotionLimits, points: Array) -> SmoothPath:
    """Return the quickest motion along a straight line."""
    way = points[1] - points[0]
    spans, jolt = line_times(limits, way)
    jerks = jolt * np.array([1.0, 0.0, -1.0, 0.0, -1.0, 0.0, 1.0])
    kept = spans > 0.0
    spans, jerks = spans[kept], jerks[kept]
    t = np.concatenate([[0.0], np.cumsum(spans)])
    a = np.concatenate([[0.0], np.cumsum(jerks * spans)])
    v = np.concatenate([[0.0], np.cumsum(spans * (a[:-1] + a[1:]) / 2.0)])
    gone = spans * v[:-1] + spans**2 * (2.0 * a[:-1] + a[1:]) / 6.0
    s = np.concatenate([[0.0], np.cumsum(gone)])
    v[-1] = a[-1] = 0.0
    q = points[0] + s[:, None] * way
    q[-1] = points[1]
    return SmoothPath(t, q, v[:, None] * way, a[:, None] * way, t[[0, -1]])
