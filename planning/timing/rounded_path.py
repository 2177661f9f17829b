"""Polylines with rounded corners: curves of continuous curvature, close to them.

A skill follows a *rounded path*. Within a length h before and after each corner, the curvature rises linearly up
to the corner and falls linearly after it. With x the arc length from the corner and d the change of direction,
this adds d (h - abs(x))^3 / (6 h^2) to the polyline. Terms of neighbouring corners add up: the curvature is nearly
constant along many short segments with equal angles between them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planning.kernels import kernel
from planning.transforms import Array

_SWEEPS = 40
"""Times at most that all corners are looked at to find how far they can be rounded."""


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
