"""A convex body in straight joint-space motion, with bounds on its extent and its displacement."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from planning.cell.workcell import NO_ERROR, PoseError
from planning.transforms import Array, Indices
from scheduling.witness.parts import ConvexPart
from scheduling.witness.robot import SeenFrom, WitnessRobot
from scheduling.witness.shapes import farthest, farthest_from
from scheduling.witness.sweeps import DIRECTIONS

_BOTH_SENSES = np.concatenate([DIRECTIONS, -DIRECTIONS])

_FINER = 4
"""Pieces that one is cut into where it is looked at closer."""


@dataclass(frozen=True)
class Motion:
    """Motion of a part, from knot to knot.

    Attributes:
        robot: that it belongs to, and from where it is seen; None for what does not move.
        part: the part.
        knots: piece k leads straight from knot k to knot k + 1, shape (s + 1, n).
        frames: of its joint at the knots, shape (s + 1, 4, 4).
        error: of the frame from which all this is seen: wherever the part is said to be, it may
            be as far away as that allows.
        origin: of that frame, shape (3,) [m].
        deviates: how far any point of it may be off besides in each piece, shape (s,) [m]; None for
            nowhere.
    """

    robot: WitnessRobot | SeenFrom | None
    part: ConvexPart
    knots: Array
    frames: Array
    error: PoseError = NO_ERROR
    origin: Array = field(default_factory=lambda: np.zeros(3))
    deviates: Array | None = None

    def __len__(self) -> int:
        """Return the number of pieces."""
        return len(self.knots) - 1

    def reach(self, pieces: Indices, direction: Array) -> Array:
        """Return an upper bound of the part's extent along a direction in pieces, shape (k,) [m].

        It is where it reaches at the ends of the piece, and by how much no point of it leaves
        the straight line between its own places there.
        """
        ends = np.stack([pieces, pieces + 1])
        reach = self._at_knots(self.frames[ends.reshape(-1)], direction[None])
        most = reach.reshape(2, -1).max(axis=0) + self._bulge(pieces)
        return np.asarray(most + self.strays(pieces))

    def extents(self, pieces: Indices) -> tuple[Array, Array]:
        """Return bounds of the part's extents along DIRECTIONS, least and most, both (13, k) [m]."""
        here, first = np.arange(len(self.knots)), pieces
        if len(pieces) < len(self):
            here = np.unique(np.concatenate([pieces, pieces + 1]))
            first = np.searchsorted(here, pieces)
        bulge = self._bulge(pieces) + self.strays(pieces)
        most, least = np.split(self._at_knots(self.frames[here], _BOTH_SENSES), 2)
        low = np.minimum(-least[:, first], -least[:, first + 1]) - bulge
        return low, np.maximum(most[:, first], most[:, first + 1]) + bulge

    def strays(self, pieces: Indices) -> Array:
        """Return a bound on the displacement of any point of the part by errors in pieces, shape (k,) [m]."""
        off = np.zeros(len(pieces)) if self.deviates is None else self.deviates[pieces]
        if not self.error:
            return off
        ends = np.stack([pieces, pieces + 1])
        far = self._from_origin(self.frames[ends.reshape(-1)]).reshape(2, -1)
        most = far.max(axis=0) + self._bulge(pieces)
        return np.asarray(off + self.error.m + self.error.rad * most)

    def strays_at(self, frame: Array, piece: int = 0) -> float:
        """Return the same bound at a joint pose in a piece, shape (4, 4) [m]."""
        off = 0.0 if self.deviates is None else self.deviates[piece]
        far = self._from_origin(frame[None])[0] if self.error else 0.0
        return float(off + self.error.m + self.error.rad * far)

    def with_errors_scaled(self, share: float) -> Motion:
        """Return the motion with scaled errors."""
        error, deviates = NO_ERROR, None
        if share:
            error = PoseError(share * self.error.m, share * self.error.rad)
            deviates = None if self.deviates is None else share * self.deviates
        return replace(self, error=error, deviates=deviates)

    def _from_origin(self, frames: Array) -> Array:
        """Return the largest distance of the part's points from the origin, shape (k,) [m]."""
        poses = frames @ self.part.local
        turned = np.swapaxes(poses[:, :3, :3], 1, 2)
        seen = turned @ (self.origin - poses[:, :3, 3])[..., None]
        return farthest_from(self.part.shape, seen[..., 0])

    def frame(self, piece: int) -> Array:
        """Return the joint pose in the middle of a piece, shape (4, 4)."""
        if self.robot is None:
            return np.asarray(self.frames[piece])
        middle = 0.5 * (self.knots[piece] + self.knots[piece + 1])
        return self.robot.joint_frame(middle, self.part.joint)

    def moved(self, piece: int) -> float:
        """Return a bound on the displacement of the part from the middle of a piece [m]."""
        if self.robot is None:
            return 0.0
        step = np.abs(self.knots[piece + 1] - self.knots[piece])
        return 0.5 * float(step @ self.part.weight)

    def finer(self, piece: int) -> Motion:
        """Return one piece cut into several; only one where the part stands."""
        count = _FINER if self.moved(piece) > 0.0 else 1
        share = np.linspace(0.0, 1.0, count + 1)[:, None]
        knots = (1.0 - share) * self.knots[piece] + share * self.knots[piece + 1]
        if self.robot is None or count == 1:
            frames = self.frames[piece : piece + 2]
        else:
            frames = self.robot.joint_frames_along(knots)[:, self.part.joint + 1]
        off = self.deviates
        deviates = None if off is None else np.full(count, off[piece])
        return replace(self, knots=knots, frames=frames, deviates=deviates)

    def _at_knots(self, frames: Array, directions: Array) -> Array:
        """Return the part's extents along directions at joint poses, (d, k) [m]."""
        local = directions @ frames[:, :3, :3]
        own = (local @ self.part.local[:3, :3]).reshape(-1, 3)
        reach = farthest(self.part.shape, own).reshape(local.shape[:2])
        reach += local @ self.part.local[:3, 3] + frames[:, :3, 3] @ directions.T
        return np.asarray(reach.T)

    def _bulge(self, pieces: Indices) -> Array:
        """Bounds on the deviation of any point from the straight line between its ends in pieces, shape (k,) [m].

        A point p(t) is no further from it than max |p''| / 8, and each pair of joints adds to
        p'' no more than the turn of the inner times what the outer one moves.
        """
        if self.robot is None:
            return np.zeros(len(pieces))
        step = np.abs(self.knots[pieces + 1] - self.knots[pieces])
        turn = step * self.robot.turns
        inner = 2.0 * np.cumsum(turn, axis=1) - turn
        return np.asarray((step * inner) @ self.part.weight / 8.0)
