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

from planning.cell.robot_model import MotionLimits
from planning.timing.curve_times import PathPiece, line_times, quickest_piece
from planning.timing.rounded_path import rounded_path
from planning.transforms import Array

STRAY = 1e-4
"""Farthest from the polyline around a corner that is not stopped at, all joints added up [rad or m]."""

_ROUNDED = 0.8
"""Share of it for rounding corners."""

FOLLOWED = (1.0 - _ROUNDED) * STRAY
"""Farthest from the rounded path when it is followed, all joints added up [rad or m]."""

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
        pieces: motions from rest to rest that it is made of, in order.
    """

    t: Array
    q: Array
    v: Array
    a: Array
    passed: Array
    pieces: tuple[PathPiece, ...] = ()

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
    rows: list[tuple[Array, ...]] = [(np.zeros(1), points[:1], still, still)]
    passed = np.zeros(len(points))
    pieces = []
    now = 0.0
    for begin, end in pairwise(ends):
        for low, high, piece in _quickest(limits, points, begin, end):
            passed[low : high + 1] = now + piece.passed()
            t, *rest = piece.rows()
            rows.append((now + t[1:], *(row[1:] for row in rest)))
            pieces.append(piece)
            now += piece.seconds
    t, q, v, a = (np.concatenate(column) for column in zip(*rows, strict=True))
    return SmoothPath(t, q, v, a, passed[corner], tuple(pieces))


def _rests(points: Array, stops: Collection[int]) -> list[int]:
    """Return the corners between the ends at which a robot has to be at rest."""
    ways = np.diff(points, axis=0)
    unit = ways / np.linalg.norm(ways, axis=1)[:, None]
    sharp = np.sum(unit[1:] * unit[:-1], axis=1) < np.cos(_SHARP)
    return [k for k in range(1, len(points) - 1) if sharp[k - 1] or k in stops]


def _quickest(
    limits: MotionLimits, points: Array, begin: int, end: int
) -> Iterator[tuple[int, int, PathPiece]]:
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


def _in_one_go(limits: MotionLimits, points: Array) -> PathPiece | None:
    """Return a motion that is at rest at both ends only, None where it would take too many rows."""
    path = rounded_path(points, _ROUNDED * STRAY)
    return quickest_piece(limits, path, FOLLOWED)
