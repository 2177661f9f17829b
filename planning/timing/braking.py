"""Stops during a skill: braking along the path within limits, and resumption of the motion.

A motion is a spline whose control points lie on the path. Up to a stop it is unchanged. Then new control points
reduce the speed smoothly to 0, in the fewest time steps within limits. Where the robot cannot stop within limits, such
as near the end of a skill, the motion continues until it can, or to its end. After the stop the motion resumes along
the same path from rest.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from planning.cell.motion_limits import MotionLimits
from planning.kernels import kernel
from planning.timing.rounded_path import curve_points
from planning.timing.smooth_path import (
    FOLLOWED,
    Curve,
    Limits,
    PathPiece,
    SmoothPath,
    is_near_curve,
    least_step,
    limit_rows,
    pack_curve,
    quickest_piece,
)
from planning.transforms import Array

_THERE = 1e-12
"""Share of a path beyond which there is nothing left of it."""

_ROUNDING = 1e-9
"""Share by which rounding may have made a time step shorter than limits ask for."""

StopAfter = Callable[[float], tuple[float, float]]
"""Begin and end of the first stop that is not over at a time, all in seconds."""


@dataclass(frozen=True, eq=False)
class StoppedPath:
    """A motion along a path with stops.

    Attributes:
        begins: when each piece begins [s].
        pieces: motions from rest to rest, in order; between them the robot stands.
        planned: ends of the pieces of the motion without stops, from its begin, shape (p,) [s].
        ends: when each of these has come to its end, and nothing has the robot stopped, shape (p,)
            [s].
    """

    begins: tuple[float, ...]
    pieces: tuple[PathPiece, ...]
    planned: Array
    ends: Array

    def stopped_times(self, own: float) -> float:
        """Return the times at which the states of the motion without stops are reached [s].

        Args:
            own: from the begin of the motion without stops; that of some rest [s].
        """
        if own < 0.5 * self.planned[0]:
            return self.begins[0]
        return float(self.ends[np.argmin(np.abs(self.planned - own))])

    def rows(self) -> tuple[Array, Array, Array, Array]:
        """Return times [s], configurations, joint speeds and accelerations: cubic in between."""
        found = []
        for begin, piece in zip(self.begins, self.pieces, strict=True):
            t, *rest = piece.rows()
            found.append((begin + t, *rest))
        q = found[-1][1][-1:]
        found.append((self.ends[-1:], q, np.zeros_like(q), np.zeros_like(q)))
        t, q, v, a = (np.concatenate(column) for column in zip(*found, strict=True))
        return t, q, v, a


def stop_along_path(
    limits: MotionLimits,
    motion: SmoothPath,
    slower: float,
    begin: float,
    stop_after: StopAfter,
) -> StoppedPath:
    """Return a motion with stops at given times.

    Args:
        limits: of the robot.
        motion: its quickest motion without stops.
        slower: factor by which it takes longer than that.
        begin: when it begins [s].
        stop_after: what has the robot stopped.
    """
    begins: list[float] = []
    pieces: list[PathPiece] = []
    ends = []
    now = _free(stop_after, begin)
    for planned in motion.pieces:
        piece: PathPiece | None = PathPiece(
            planned.path, planned.lengths, planned.step * slower
        )
        while piece is not None:
            stop, _ = stop_after(now)
            begins.append(now)
            rest = None
            if stop < now + piece.seconds:
                piece, rest = _stopped(limits, piece, slower, stop - now)
            pieces.append(piece)
            now = _free(stop_after, now + piece.seconds)
            piece = rest
        ends.append(now)
    planned_ends = np.cumsum([slower * piece.seconds for piece in motion.pieces])
    return StoppedPath(tuple(begins), tuple(pieces), planned_ends, np.array(ends))


def _free(stop_after: StopAfter, t: float) -> float:
    """Return the earliest time from ``t`` on at which the robot is not stopped."""
    begin, end = stop_after(t)
    return end if begin <= t else t


def _stopped(
    limits: MotionLimits, piece: PathPiece, slower: float, after: float
) -> tuple[PathPiece, PathPiece | None]:
    """Return a piece with a stop in it, and the motion from there on; None where it ends in time.

    Args:
        limits: of the robot.
        piece: to brake in.
        slower: factor by which motions take longer than they need to.
        after: when the stop begins, from the start of the piece [s].
    """
    path = piece.path
    # Until then the motion has come to depend on these control points.
    given = int(after / piece.step) + 4
    controls = np.empty(len(piece.lengths))
    near = (path.curvature(), FOLLOWED)
    count = _brake(
        limit_rows(limits),
        pack_curve(path),
        near,
        (piece.lengths, piece.step),
        given,
        controls,
    )
    if count == 0:
        return piece, None
    progress = float(controls[count - 1])
    if float(path.at[-1]) - progress < _THERE * float(path.at[-1]):
        return piece, None
    rest = quickest_piece(limits, path, FOLLOWED, progress)
    if rest is None:
        return piece, None
    slow = PathPiece(path, rest.lengths, rest.step * slower)
    return PathPiece(path, controls[:count].copy(), piece.step), slow


@kernel
def _brake(
    limits: Limits,
    curve: Curve,
    near: tuple[Array, float],
    motion: tuple[Array, float],
    given: int,
    out: Array,
) -> int:
    """Write control points of a braking motion, and return their number; 0 where braking is impossible.

    Speed and acceleration fall to 0 as a polynomial of third degree does.

    Args:
        limits: of the robot.
        curve: what is followed.
        near: the curvature at its corners, and how far the motion may leave it.
        motion: control points of the motion without a stop, and its time step.
        given: how many of these are settled when the stop begins.
        out: what is written.
    """
    controls, step = motion
    total = len(controls)
    end = curve[1][-1]
    points = np.empty((total, curve[0].shape[1]))
    curve_points(*curve, controls, points)
    out[:given] = controls[:given]
    for first in range(given, total):
        out[first - 1] = controls[first - 1]
        speed = controls[first - 1] - controls[first - 2]
        rise = speed - controls[first - 2] + controls[first - 3]
        for steps in range(1, total - first):
            count = first + steps + 1
            fits = True
            for k in range(1, steps + 1):
                x = k / steps
                y = 1.0 - x
                gain = speed * y * y * (1.0 + 2.0 * x) + rise * steps * x * y * y
                out[first + k - 1] = out[first + k - 2] + gain
                fits = fits and gain >= 0.0
            out[count - 1] = out[count - 2]
            if out[count - 1] > end:
                break
            if not fits:
                continue
            low = first - 3
            curve_points(*curve, out[low:count], points[low:count])
            if least_step(limits, points[low:count]) > step * (1.0 + _ROUNDING):
                continue
            if is_near_curve(curve[1], *near, out[low:count]):
                return count
    return 0
