"""Motion of robots and their loads as straight joint-space segments with common times, and objects at rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from planning.transforms import Array, Indices
from scheduling.witness.motion import Motion
from scheduling.witness.parts import ConvexPart
from scheduling.witness.robot import WitnessRobot
from scheduling.witness.sweeps import DIRECTIONS, SweepBounds

_AT_REST = np.zeros((2, 0)), np.tile(np.eye(4), (2, 1, 1))
"""Knots and frames of bodies at rest."""


class MovingRobot:
    """A robot with a constant load, moving along a sampled path.

    Consecutive intervals in which it stands make one piece, every other interval is a piece.

    Args:
        robot: its geometry.
        parts: parts of the robot, then of its load.
        path: configurations at the ticks of the common clock, at least one, shape (m, n).

    Attributes:
        robot, parts: as given.
        begin, end: ticks at which each piece begins and ends, shape (s,).
        knots: configurations at which pieces begin and end, shape (s + 1, n).
        frames: poses of base and joints there, shape (s + 1, n + 1, 4, 4).
        motions: motion of each part.
    """

    def __init__(
        self, robot: WitnessRobot, parts: Sequence[ConvexPart], path: Array
    ) -> None:
        self.robot, self.parts = robot, parts
        if len(path) == 1:
            path = np.repeat(path, 2, axis=0)
        moves = np.any(np.diff(path, axis=0) != 0.0, axis=1)
        first = np.append(True, moves[1:] | moves[:-1])
        self.begin = np.flatnonzero(first)
        self.end = np.append(self.begin[1:], len(moves))
        self.knots = path[np.append(self.begin, len(moves))]
        self.frames = robot.joint_frames_along(self.knots)
        self.motions = [
            Motion(robot, part, self.knots, self.frames[:, part.joint + 1])
            for part in parts
        ]

    @property
    def pieces(self) -> Indices:
        """Numbers of all pieces."""
        return np.arange(len(self.begin))

    @cached_property
    def sweeps(self) -> SweepBounds:
        """Swept volume of each part in each piece."""
        extents = [motion.extents(self.pieces) for motion in self.motions]
        low, high = (np.stack(side, axis=2) for side in zip(*extents, strict=True))
        return SweepBounds((low,), (high,)).with_coarser()

    def simultaneous(self, other: MovingRobot) -> tuple[Indices, Indices]:
        """Return, per piece, the pieces of another robot at the same time: from the first number up to the second."""
        low = np.searchsorted(other.end, self.begin, side="right")
        return low, np.searchsorted(other.begin, self.end, side="left")


@dataclass(frozen=True)
class StillParts:
    """Parts at rest.

    Attributes:
        motions: of each part, none.
        sweeps: volume of each part: one piece each of one body.
    """

    motions: Sequence[Motion]
    sweeps: SweepBounds

    @staticmethod
    def of(parts: Sequence[ConvexPart]) -> StillParts:
        """Return parts, at least one, as they rest."""
        motions = [Motion(None, part, *_AT_REST) for part in parts]
        one = np.zeros(1, dtype=np.int64)
        extents = [motion.extents(one) for motion in motions]
        low, high = (np.stack(side, axis=1) for side in zip(*extents, strict=True))
        return StillParts(motions, SweepBounds((low,), (high,)))

    @staticmethod
    def joined(some: Sequence[StillParts]) -> StillParts:
        """Return all parts of several, in order."""
        low, high = (
            np.concatenate([np.zeros((len(DIRECTIONS), 0, 1)), *sides], axis=1)
            for sides in (
                [own.sweeps.low[0] for own in some],
                [own.sweeps.high[0] for own in some],
            )
        )
        motions = [motion for own in some for motion in own.motions]
        return StillParts(motions, SweepBounds((low,), (high,)))
