"""Bounds of the motion along a path besides joint limits: tool speed and joint effort.

The fastest motion along a curve is computed piece by piece. Joint effort is the sum of gravity, a term
proportional to the acceleration along the path, and a term proportional to the squared speed along the path. At
each sample, an effort limit therefore bounds speed and acceleration in the same way as an acceleration limit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from planning.kernels import inner_kernel
from planning.transforms import Array, Indices

_SPEED_SHARE = 0.5
"""Greatest share of the remaining joint effort (after gravity) used at constant full speed."""

HEAD_ROOM = 0.99
"""Share of the limits that is used around corners: rows of a motion are cubic between them."""


class EffortRows(NamedTuple):
    """Joint efforts on some pieces of a path, by row: one joint at a sample, in one direction.

    With s the path parameter, time at full speed: ``first * abs(s'') + second * s'^2 <= spare``.

    Attributes:
        spare: effort that gravity leaves, shape (rows,) [N m or N].
        first, second: shape (rows,).
        joint: joint of each row, shape (rows,).
        piece: first row of each piece, and the count of rows, shape (pieces + 1,).
    """

    spare: Array
    first: Array
    second: Array
    joint: Indices
    piece: Indices

    def full_speed_factor(self) -> float:
        """Return the factor by which full speed must be lowered for joints to accelerate at it.

        It is at least 1. Joints without effort left by gravity are ignored: no speed helps them.
        """
        known = (self.spare > 0.0) & np.isfinite(self.spare)
        share = self.second[known] / (_SPEED_SHARE * self.spare[known])
        return float(np.sqrt(np.max(share, initial=1.0)))

    def shares(self, ramp: float, speed: Array) -> Array:
        """Return joint efforts relative to the margin left by gravity, shape (rows,).

        Args:
            ramp: time from rest to full speed [s].
            speed: share of full speed on each piece, shape (pieces,).
        """
        square = np.repeat(speed**2, np.diff(self.piece))
        return np.asarray((self.first / ramp + self.second * square) / self.spare)


class PathEfforts(NamedTuple):
    """Joint efforts on a polyline with rounded corners.

    Attributes:
        legs: along the straight legs; a piece is a leg.
        bends: along the bent pieces.
    """

    legs: EffortRows
    bends: EffortRows

    def nearest(self, ramp: float, bent_ramp: float, speed: Array) -> int:
        """Return the joint nearest to its effort limit.

        Args:
            ramp: time from rest to full speed on the legs [s].
            bent_ramp: the same around corners [s].
            speed: share of full speed on each bent piece, shape (p,).
        """
        full = np.ones(len(self.legs.piece) - 1)
        legs = self.legs.shares(ramp, full)
        shares = np.append(legs, self.bends.shares(bent_ramp, speed) / HEAD_ROOM)
        joints = np.append(self.legs.joint, self.bends.joint)
        return int(joints[np.argmax(shares)])


@dataclass(frozen=True, eq=False)
class PathBounds:
    """Bounds of a polyline with rounded corners besides joint limits.

    Attributes:
        cap: greatest share of full speed on each bent piece, shape (p,).
        efforts: joint efforts; None where unknown.
    """

    cap: Array
    efforts: PathEfforts | None = None


def unlimited_efforts(legs: int, bends: int) -> PathEfforts:
    """Return effort bounds that nothing exceeds.

    Args:
        legs: straight legs of the path.
        bends: bent pieces of it.
    """
    none, whose = np.zeros(0), np.zeros(0, dtype=np.int64)
    return PathEfforts(
        *(
            EffortRows(none, none, none, whose, np.zeros(pieces + 1, dtype=np.int64))
            for pieces in (legs, bends)
        )
    )


@inner_kernel
def least_ramp(legs: EffortRows) -> float:
    """Return the shortest time from rest to full speed within effort limits, infinite where none is."""
    ramp = 0.0
    for row in range(len(legs.spare)):
        left = legs.spare[row] - legs.second[row]
        if left <= 0.0:
            return np.inf
        ramp = max(ramp, legs.first[row] / left)
    return ramp


@inner_kernel
def torque_limited_speed(bends: EffortRows, piece: int, rate: float) -> float:
    """Return the greatest share of full speed within effort limits on a bent piece, 0 where none is.

    Args:
        bends: of the path.
        piece: of it.
        rate: most that the share changes in a second there [1/s].
    """
    greatest = 1.0
    for row in range(bends.piece[piece], bends.piece[piece + 1]):
        left = HEAD_ROOM * bends.spare[row] - bends.first[row] * rate
        if left < 0.0:
            return 0.0
        if bends.second[row] * greatest * greatest > left:
            greatest = np.sqrt(left / bends.second[row])
    return greatest
