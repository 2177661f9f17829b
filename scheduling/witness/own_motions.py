"""Relative motion of parts of one robot, in the frame of the joint that carries the inner one."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

import numpy as np
import numpy.typing as npt

from planning.transforms import Array, Indices
from scheduling.witness.measuring import Measuring
from scheduling.witness.motion import Motion
from scheduling.witness.parts import ConvexPart
from scheduling.witness.robot import SeenFrom, WitnessRobot


class OwnMotions:
    """A robot in pieces of motion, for parts of it that may meet each other.

    Args:
        robot: the robot.
        knots: piece k leads straight from knot k to knot k + 1, shape (s + 1, n).
    """

    def __init__(self, robot: WitnessRobot, knots: Array) -> None:
        self._robot, self._knots = robot, knots
        self._seen = cache(self._seen_from)

    def too_close(
        self,
        measuring: Measuring,
        parts: tuple[ConvexPart, ConvexPart],
        pieces: Indices,
        limit: float,
        alike: Indices,
    ) -> Iterator[tuple[int, float]]:
        """Yield pieces in which two parts come too close, with the measured distance [m].

        Args:
            measuring: measures them.
            parts: the two; the first one is not further out than the second one.
            pieces: to look at, shape (k,).
            limit: clearance that they must keep [m].
            alike: of pieces with the same number only the first found is yielded, shape (s,).
        """
        inner, outer = parts
        view, frames = self._seen(inner.joint)
        still = Motion(None, inner, np.zeros((2, 0)), np.tile(np.eye(4), (2, 1, 1)))
        own = frames[:, outer.joint + 1]
        moves = Motion(view, view.seen(outer), self._knots, own)
        pieces = pieces[_balls_meet(inner, moves, pieces, limit)]
        if not len(pieces):
            return
        low, high = moves.extents(pieces)
        least, most = still.extents(np.zeros(1, dtype=np.int64))
        near = np.all(np.maximum(low - most, least - high) < limit, axis=0)
        left = pieces[near]
        pairs = np.zeros_like(left), left
        for found in measuring.too_close(still, moves, pairs, limit, alike[left]):
            yield int(left[found.pair]), found.gap

    def _seen_from(self, joint: int) -> tuple[SeenFrom, Array]:
        """Return the robot relative to a joint, and the poses of its joints at the knots."""
        view = SeenFrom(self._robot, joint)
        return view, view.joint_frames_along(self._knots)


def _balls_meet(
    inner: ConvexPart, moves: Motion, pieces: Indices, limit: float
) -> npt.NDArray[np.bool_]:
    """Tell in which pieces the bounding balls of two parts may come nearer than a limit."""
    outer = moves.part
    frames = moves.frames[np.stack([pieces, pieces + 1])]
    centres = frames[..., :3, :3] @ outer.centre + frames[..., :3, 3]
    away = np.linalg.norm(centres - inner.centre, axis=2).min(axis=0)
    way = np.abs(moves.knots[pieces + 1] - moves.knots[pieces])
    room = inner.radius + outer.radius + 0.5 * way @ outer.weight
    return np.asarray(away < room + max(limit, 0.0))
