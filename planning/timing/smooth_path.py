"""Time-optimized motion of a skill along its reference path within the limits of a robot.

The robot stops at sharp corners, and wherever an object changes hands. In between, gentle corners are rounded
within ``STRAY`` of the polyline, far within the margins of the collision checks. The speed along the rounded path
follows an S-curve: it rises, stays constant and falls with bounded jerk. If a stop at a corner is faster, the robot
stops there.

The motion is a uniform cubic spline over time. The arc length over time is a cubic spline, too; its pieces have
constant jerk, and their durations are whole numbers of time steps. The points of the path at the control values of
this spline are the control points of the motion. The motion lies in the convex hull of its control points, so it
stays near the path. Its speeds, accelerations and jerks are differences of control points divided by powers of the
time step. The least time step within all limits therefore follows directly; the durations of the pieces are found by
a search.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from planning.cell.motion_limits import MotionLimits
from planning.kernels import inner_kernel, kernel
from planning.timing.blended_path import STRAY
from planning.timing.rounded_path import RoundedPath, curve_points, rounded_path
from planning.timing.stretch import LEAST_BUILD_UP
from planning.transforms import Array

_FEWEST_STEPS, _MOST_STEPS = 32, 512
"""Bounds of the number of time steps."""

_BUILD_UP = 8.0
"""Time steps, at least, in which an acceleration builds up ..."""

_FINE = 96
"""... unless that would be more in all: then it does so in one step, which takes a per cent longer."""

_LONGEST = 0.01
"""Longest time step of motions at full speed, unless it is the number that counts [s]."""

Limits = tuple[Array, Array, Array, float]
Curve = tuple[Array, Array, Array, Array]

_ROUNDED = 0.8
"""Share of it for rounding corners."""

FOLLOWED = (1.0 - _ROUNDED) * STRAY
"""Farthest from the rounded path when it is followed, all joints added up [rad or m]."""

_SHARP = np.radians(20.0)
"""A robot stops at corners that turn by more."""

_SAME = 1e-12
"""Waypoints nearer to each other are one [rad or m]."""


def line_times(limits: MotionLimits, displacement: Array) -> tuple[Array, float]:
    """Return the fastest motion along a straight line in joint space, from rest to rest.

    Args:
        limits: of the robot.
        displacement: from start to end, not 0, shape (n,) [rad or m].

    Returns:
        How long its seven pieces take, in which the jerk is positive, 0, negative, 0, negative, 0 and
        positive, shape (7,) [s]; and that jerk over the way [1/s^3].
    """
    far = np.maximum(np.abs(displacement), 1e-300)
    speed = min(float(np.min(limits.velocity / far)), limits.sum_of_speeds / far.sum())
    rise = float(np.min(limits.acceleration / far))
    jolt = min(float(np.min(limits.jerk / far)), rise / LEAST_BUILD_UP)
    build, stay, steady = s_curve_times(1.0, speed, rise, jolt)
    return np.array([build, stay, build, steady, build, stay, build]), jolt


@kernel
def s_curve_times(
    length: float, speed: float, rise: float, jolt: float
) -> tuple[float, float, float]:
    """Return the durations of the pieces of a time-optimal S-curve within limits.

    The acceleration builds up, stays, and falls to 0; the speed stays; the same in reverse.

    Args:
        length: of the path, above 0.
        speed: limit of speed.
        rise: limit of acceleration.
        jolt: limit of jerk, maybe infinite.

    Returns:
        How long the acceleration builds up, how long it stays, and how long the speed stays.
    """
    build = rise / jolt
    if speed * jolt < rise * rise:
        build = math.sqrt(speed / jolt)
        stay = 0.0
    else:
        stay = speed / rise - build
    steady = length / speed - 2.0 * build - stay
    if steady >= 0.0:
        return build, stay, steady
    build = rise / jolt
    whole = 0.5 * build + math.sqrt(0.25 * build * build + length / rise)
    if whole >= 2.0 * build:
        return build, whole - 2.0 * build, 0.0
    return (0.5 * length / jolt) ** (1.0 / 3.0), 0.0, 0.0


@dataclass(frozen=True, eq=False)
class PathPiece:
    """A motion along a rounded path from rest to rest.

    Attributes:
        path: what is followed.
        lengths: along it, of control points, shape (k + 3,) for k time steps; the first three are the
            same, and the last three are.
        step: time step [s].
    """

    path: RoundedPath
    lengths: Array
    step: float

    @property
    def seconds(self) -> float:
        """How long it takes [s]."""
        return self.step * (len(self.lengths) - 3)

    def rows(self) -> tuple[Array, Array, Array, Array]:
        """Return times from 0 [s], configurations, joint speeds and accelerations between steps."""
        control = self.path.points(self.lengths)
        before, at, after = control[:-2], control[1:-1], control[2:]
        t = self.step * np.arange(len(at), dtype=np.float64)
        q = (before + 4.0 * at + after) / 6.0
        q[0], q[-1] = control[0], control[-1]
        v = (after - before) / (2.0 * self.step)
        return t, q, v, (after - 2.0 * at + before) / self.step**2

    def passed(self) -> Array:
        """Return the time of passing each corner of the path, shape (w,) [s]."""
        before, at, after = self.lengths[:-2], self.lengths[1:-1], self.lengths[2:]
        gone = (before + 4.0 * at + after) / 6.0
        passed = self.step * np.interp(self.path.at, gone, np.arange(len(at)))
        passed[0], passed[-1] = 0.0, self.step * (len(at) - 1)
        return passed


def quickest_piece(
    limits: MotionLimits, path: RoundedPath, stray: float, begin: float = 0.0
) -> PathPiece | None:
    """Return a fast motion along a rounded path from rest to rest.

    Args:
        limits: of the robot.
        path: what to follow.
        stray: allowed deviation from the curve, summed over all joints.
        begin: arc length at which the motion starts.

    Returns:
        The motion; None where that would take more time steps than are offered.
    """
    bends = path.curvature()
    length = float(path.at[-1]) - begin
    # Nowhere twice as fast as in the mean; and in some steps accelerations build up. A stop by
    # the clock is heard of from the next step on.
    close = 2.0 * length * np.sqrt(bends.max() / (6.0 * stray))
    travel = np.abs(np.diff(path.corners, axis=0)).sum(axis=0)
    spans, _ = line_times(limits, travel * (length / float(path.at[-1])))
    fine = min(_BUILD_UP * spans.sum() / spans[0], _FINE)
    wanted = max(close, fine, float(spans.sum()) / _LONGEST)
    count = int(np.clip(np.ceil(wanted), _FEWEST_STEPS, _MOST_STEPS))
    lengths, points = np.empty(count + 3), np.empty((count + 3, path.corners.shape[1]))
    # As along a straight line, to begin with.
    jerky = max(1, int(count * spans[0] / spans.sum()))
    steady = int(count * spans[1] / spans.sum())
    shape = jerky, max(0, min(steady, (count - 4 * jerky) // 2))
    curve, near = (begin, *pack_curve(path)), (bends, stray)
    step = _quickest_steps(limit_rows(limits), curve, near, shape, lengths, points)
    return PathPiece(path, lengths, step) if np.isfinite(step) else None


def limit_rows(limits: MotionLimits) -> Limits:
    """Return limits in the form that kernels take."""
    return (
        limits.velocity,
        limits.acceleration,
        limits.jerk,
        float(limits.sum_of_speeds),
    )


def pack_curve(path: RoundedPath) -> Curve:
    """Return a rounded path in the form that kernels take."""
    return path.corners, path.at, path.turn, path.reach


@kernel
def _quickest_steps(
    limits: Limits,
    curve: tuple[float, Array, Array, Array, Array],
    near: tuple[Array, float],
    shape: tuple[int, int],
    lengths: Array,
    points: Array,
) -> float:
    """Write the best control points found, and return their time step; see ``_tried``."""
    count = len(lengths) - 3
    jerky, steady = shape
    best = _tried(limits, curve, near, shape, lengths, points)
    stride = max(1, count // 12)
    while stride > 0:
        better = False
        m0, k0 = jerky, steady
        wide = 2 if stride == 1 else 1
        for a in range(-wide, wide + 1):
            for b in range(-wide - 1, wide + 2):
                m, k = m0 + a * stride, k0 + b * stride
                if m < 1 or k < 0 or 4 * m + 2 * k > count:
                    continue
                step = _tried(limits, curve, near, (m, k), lengths, points)
                if step < best:
                    best, jerky, steady, better = step, m, k, True
        if not better:
            stride //= 2
    return _tried(limits, curve, near, (jerky, steady), lengths, points)


@inner_kernel
def _tried(
    limits: Limits,
    curve: tuple[float, Array, Array, Array, Array],
    near: tuple[Array, float],
    shape: tuple[int, int],
    lengths: Array,
    points: Array,
) -> float:
    """Write the control points of an S-curve, and return their least time step.

    Args:
        limits: of speed, acceleration, jerk, and the sum of speeds.
        curve: where on it the motion starts, and the curve that is followed.
        near: the curvature at its corners, and how far the motion may leave it.
        shape: steps in which the acceleration changes, four times, and in which it stays, twice.
        lengths, points: outputs.
    """
    jerky, steady = shape
    begin, corners, at, turn, reach = curve
    end = at[-1]
    _s_curve(jerky, steady, end - begin, lengths)
    for i in range(len(lengths)):
        lengths[i] = min(lengths[i] + begin, end)
    for i in range(3):
        lengths[len(lengths) - 1 - i] = end
    curve_points(corners, at, turn, reach, lengths, points)
    least = least_step(limits, points)
    return least if is_near_curve(at, *near, lengths) else np.inf


@inner_kernel
def _s_curve(jerky: int, steady: int, length: float, lengths: Array) -> None:
    """Write the control values of an S-curve from 0 to a length."""
    count = len(lengths) - 3
    lengths[0] = lengths[1] = lengths[2] = 0.0
    rise, speed = 0.0, 0.0
    for i in range(count):
        j = min(i, count - 1 - i)
        if j < jerky:
            rise += 1.0
        elif jerky + steady <= j < 2 * jerky + steady:
            rise -= 1.0
        speed += rise
        lengths[i + 3] = lengths[i + 2] + speed
    scale = length / lengths[count + 2]
    for i in range(count + 3):
        lengths[i] *= scale


@inner_kernel
def least_step(limits: Limits, points: Array) -> float:
    """Return the least time step in which a spline of these control points keeps all limits."""
    velocity, acceleration, jerk, sum_of_speeds = limits
    count, n = points.shape
    speed, rise, jolt = 0.0, 0.0, 0.0
    for i in range(1, count):
        total = 0.0
        for d in range(n):
            first = points[i, d] - points[i - 1, d]
            total += abs(first)
            speed = max(speed, abs(first) / velocity[d])
            if i > 1:
                second = first - points[i - 1, d] + points[i - 2, d]
                rise = max(rise, abs(second) / acceleration[d])
                if i > 2:
                    third = second - points[i - 1, d] + 2.0 * points[i - 2, d]
                    third -= points[i - 3, d]
                    jolt = max(jolt, abs(third) / jerk[d])
        speed = max(speed, total / sum_of_speeds)
    return max(speed, max(math.sqrt(rise), math.pow(jolt, 1.0 / 3.0)))


@inner_kernel
def is_near_curve(at: Array, bends: Array, stray: float, lengths: Array) -> bool:
    """Return whether a spline through points of a curve stays near the curve.

    It is off by half the curvature times the variance of the ways of the four control points that a
    place of it is made of, which is a third of the square of their distance at most.
    """
    piece = 0
    for i in range(len(lengths) - 3):
        while piece < len(at) - 2 and lengths[i] > at[piece + 1]:
            piece += 1
        bend = max(bends[piece], bends[piece + 1])
        beyond = piece + 2
        while beyond < len(at) and at[beyond - 1] < lengths[i + 3]:
            bend = max(bend, bends[beyond])
            beyond += 1
        wide = max(lengths[i + 1] - lengths[i], lengths[i + 2] - lengths[i + 1])
        wide = max(wide, lengths[i + 3] - lengths[i + 2])
        if bend * wide * wide > 6.0 * stray * (1.0 + 1e-9):
            return False
    return True


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
    """Return a fast motion along a polyline within limits.

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
        for low, high, piece in _motions_between(limits, points, begin, end):
            passed[low : high + 1] = now + piece.passed()
            t, *rest = piece.rows()
            rows.append((now + t[1:], *(row[1:] for row in rest)))
            pieces.append(piece)
            now += piece.seconds
    t, q, v, a = (np.concatenate(column) for column in zip(*rows, strict=True))
    return SmoothPath(t, q, v, a, passed[corner], tuple(pieces))


def _rests(points: Array, stops: Collection[int]) -> list[int]:
    """Return the inner corners at which a robot must be at rest."""
    displacements = np.diff(points, axis=0)
    unit = displacements / np.linalg.norm(displacements, axis=1)[:, None]
    sharp = np.sum(unit[1:] * unit[:-1], axis=1) < np.cos(_SHARP)
    return [k for k in range(1, len(points) - 1) if sharp[k - 1] or k in stops]


def _motions_between(
    limits: MotionLimits, points: Array, begin: int, end: int
) -> Iterator[tuple[int, int, PathPiece]]:
    """Yield motions from rest to rest between gentle corners of a polyline, with their ends.

    They are one, or more where stops at the sharpest corners save time.
    """
    whole = _without_rests(limits, points[begin : end + 1])
    if end - begin > 1:
        displacements = np.diff(points[begin : end + 1], axis=0)
        unit = displacements / np.linalg.norm(displacements, axis=1)[:, None]
        middle = begin + 1 + int(np.argmin(np.sum(unit[1:] * unit[:-1], axis=1)))
        sides = np.array_split(displacements, [middle - begin])
        # Along the straight lines to the corner and from it the parts do not take much longer.
        least = sum(
            float(line_times(limits, side.sum(axis=0))[0].sum()) for side in sides
        )
        if whole is None or least < whole.seconds:
            parts = [
                *_motions_between(limits, points, begin, middle),
                *_motions_between(limits, points, middle, end),
            ]
            if whole is None or sum(p.seconds for *_, p in parts) < whole.seconds:
                yield from parts
                return
    assert whole is not None
    yield begin, end, whole


def _without_rests(limits: MotionLimits, points: Array) -> PathPiece | None:
    """Return a motion without intermediate rests, None where it would take too many rows."""
    path = rounded_path(points, _ROUNDED * STRAY)
    return quickest_piece(limits, path, FOLLOWED)
