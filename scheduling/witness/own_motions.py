"""Relative motion of two parts of the same robot, for self-collision checks.

Motion is expressed in the frame of the joint that carries the part closer to the base.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache

import numpy as np
import numpy.typing as npt

from planning.transforms import Array, Indices
from scheduling.witness.measuring import Measuring
from scheduling.witness.motion import Motion
from scheduling.witness.parts import ConvexPart
from scheduling.witness.robot import SeenFrom, WitnessRobot, inverses


class OwnMotions:
    """A robot in pieces of motion, for parts of it that may meet each other.

    Args:
        robot: the robot.
        knots: piece k leads straight from knot k to knot k + 1, shape (s + 1, n).
        frames: poses of base and joints at the knots, shape (s + 1, n + 1, 4, 4).
    """

    def __init__(self, robot: WitnessRobot, knots: Array, frames: Array) -> None:
        self._robot, self._knots, self._frames = robot, knots, frames
        self._view = cache(lambda joint: SeenFrom(robot, joint))
        self._relative = cache(self._frames_from)

    def seen(self, inner: ConvexPart, outer: ConvexPart) -> tuple[Motion, Motion]:
        """Return the motions of two parts in the frame of the joint that carries the inner one."""
        view = self._view(inner.joint)
        still = Motion(None, inner, np.zeros((2, 0)), np.tile(np.eye(4), (2, 1, 1)))
        frames = self._relative(inner.joint, outer.joint)
        return still, Motion(view, view.seen(outer), self._knots, frames)

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
        still, moves = self.seen(*parts)
        pieces = pieces[_balls_meet(still.part, moves, pieces, limit)]
        if not len(pieces):
            return
        low, high = moves.extents(pieces)
        least, most = still.extents(np.zeros(1, dtype=np.int64))
        near = np.all(np.maximum(low - most, least - high) < limit, axis=0)
        left = pieces[near]
        pairs = np.zeros_like(left), left
        for found in measuring.too_close(still, moves, pairs, limit, alike[left]):
            yield int(left[found.pair]), found.gap

    def _frames_from(self, inner: int, outer: int) -> Array:
        """Return the poses of a joint in the frame of another one at the knots, shape (s + 1, 4, 4)."""
        frames = self._frames
        return np.asarray(inverses(frames[:, inner + 1]) @ frames[:, outer + 1])


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
