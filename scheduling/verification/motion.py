"""A convex part in straight joint-space motions, and how far it reaches in them.

Distances of parts in motion: few are measured, and each settles many pairs of pieces. Where two parts are apart in the
middle of two pieces, coal says in which direction. How far both reach in that direction bounds the distance in all of
their pieces at once, and most of them are settled by that. What is left is cut finer.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from planning.cell.workcell import NO_ERROR, PoseError
from planning.transforms import Array, Indices
from scheduling.verification.reference import (
    ReferenceBody,
    ReferenceRobot,
    SeenFrom,
    separation,
)
from scheduling.verification.sweeps import DIRECTIONS, farthest, farthest_from

_FINER = 4
"""Pieces that one is cut into where it is looked at closer."""


@dataclass(frozen=True)
class Motion:
    """A part, from knot to knot.

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

    robot: ReferenceRobot | SeenFrom | None
    part: ReferenceBody
    knots: Array
    frames: Array
    error: PoseError = NO_ERROR
    origin: Array = field(default_factory=lambda: np.zeros(3))
    deviates: Array | None = None

    def __len__(self) -> int:
        """Return the number of pieces."""
        return len(self.knots) - 1

    def reach(self, pieces: Indices, direction: Array) -> Array:
        """Return how far the part gets along a direction in pieces, never less, shape (k,) [m].

        It is where it reaches at the ends of the piece, and by how much no point of it leaves
        the straight line between its own places there.
        """
        ends = np.stack([pieces, pieces + 1])
        reach = self._at_knots(self.frames[ends.reshape(-1)], direction[None])
        most = reach.reshape(2, -1).max(axis=0) + self._bulge(pieces)
        return np.asarray(most + self.strays(pieces))

    def extents(self, pieces: Indices) -> tuple[Array, Array]:
        """Return how far the part gets along DIRECTIONS, least and most, both (13, k) [m]."""
        here = np.unique(np.concatenate([pieces, pieces + 1]))
        first = np.searchsorted(here, pieces)
        frames = self.frames[here]
        bulge = self._bulge(pieces) + self.strays(pieces)
        most = self._at_knots(frames, DIRECTIONS)
        least = -self._at_knots(frames, -DIRECTIONS)
        low = np.minimum(least[:, first], least[:, first + 1]) - bulge
        return low, np.maximum(most[:, first], most[:, first + 1]) + bulge

    def strays(self, pieces: Indices) -> Array:
        """Return how far errors take any point of the part in pieces, at most, shape (k,) [m]."""
        off = np.zeros(len(pieces)) if self.deviates is None else self.deviates[pieces]
        if not self.error:
            return off
        ends = np.stack([pieces, pieces + 1])
        far = self._from_origin(self.frames[ends.reshape(-1)]).reshape(2, -1)
        most = far.max(axis=0) + self._bulge(pieces)
        return np.asarray(off + self.error.m + self.error.rad * most)

    def strays_at(self, frame: Array, piece: int = 0) -> float:
        """Return the same where the joint is at a pose in a piece, shape (4, 4) [m]."""
        off = 0.0 if self.deviates is None else self.deviates[piece]
        far = self._from_origin(frame[None])[0] if self.error else 0.0
        return float(off + self.error.m + self.error.rad * far)

    def off_by(self, share: float) -> Motion:
        """Return it with a share of its errors."""
        error, deviates = NO_ERROR, None
        if share:
            error = PoseError(share * self.error.m, share * self.error.rad)
            deviates = None if self.deviates is None else share * self.deviates
        return replace(self, error=error, deviates=deviates)

    def _from_origin(self, frames: Array) -> Array:
        """Return how far points of the part are from the origin at most, shape (k,) [m]."""
        poses = frames @ self.part.local
        turned = np.swapaxes(poses[:, :3, :3], 1, 2)
        seen = turned @ (self.origin - poses[:, :3, 3])[..., None]
        return farthest_from(self.part.shape, seen[..., 0])

    def frame(self, piece: int) -> Array:
        """Return the pose of the joint in the middle of a piece, shape (4, 4)."""
        if self.robot is None:
            return np.asarray(self.frames[piece])
        middle = 0.5 * (self.knots[piece] + self.knots[piece + 1])
        return self.robot.joint_frame(middle, self.part.joint)

    def moved(self, piece: int) -> float:
        """Return how far the part gets at most from where it is in the middle [m]."""
        step = np.abs(self.knots[piece + 1] - self.knots[piece])
        return 0.5 * float(step @ self.part.weight)

    def finer(self, piece: int) -> Motion:
        """Return one piece, cut into several; into one only where the part stands."""
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
        """Return how far the part gets along directions at poses of its joint, (d, k) [m]."""
        local = np.tensordot(directions, frames[:, :3, :3], axes=(1, 1))
        own = local.reshape(-1, 3) @ self.part.local[:3, :3]
        reach = farthest(self.part.shape, own).reshape(local.shape[:2])
        there = local @ self.part.local[:3, 3]
        return np.asarray(reach + there + directions @ frames[:, :3, 3].T)

    def _bulge(self, pieces: Indices) -> Array:
        """Return how far any point leaves the straight line between its ends, shape (k,) [m].

        A point p(t) is no further from it than max |p''| / 8, and each pair of joints adds to
        p'' no more than the turn of the inner times what the outer one moves.
        """
        if self.robot is None:
            return np.zeros(len(pieces))
        step = np.abs(self.knots[pieces + 1] - self.knots[pieces])
        turn = step * self.robot.turns
        inner = 2.0 * np.cumsum(turn, axis=1) - turn
        return np.asarray(((step * self.part.weight) * inner).sum(axis=1) / 8.0)


_FINEST = 1e-5
"""Motions that get no further than this are not cut [m]."""
_TOGETHER = 256
"""Pairs that one direction is tried on."""


class TooClose(NamedTuple):
    """Two parts in two pieces.

    Attributes:
        pair: number of the pair of pieces.
        gap: what is left of their distance in the worst case [m].
        strayed: what errors may take of it, so that their distance is both together [m].
    """

    pair: int
    gap: float
    strayed: float


class Measuring:
    """Finds pieces in which two parts come too close.

    Attributes:
        least: least distance measured so far, less what errors may take of it, infinite before the
            first [m].
    """

    def __init__(self) -> None:
        self.least = math.inf

    def too_close(
        self,
        x: Motion,
        y: Motion,
        pairs: tuple[Indices, Indices],
        limit: float,
        alike: Indices,
    ) -> Iterator[TooClose]:
        """Yield which pairs of pieces come too close, with the distance that was measured.

        Args:
            x, y: the two parts.
            pairs: pieces of both, each of shape (k,).
            limit: what they have to keep [m].
            alike: of pairs with the same number only the first found is yielded, shape (k,).
        """
        rows, columns = pairs
        left = np.arange(len(rows))
        while len(left):
            middle = len(left) // 2
            pair = int(left[middle])
            row, column = int(rows[pair]), int(columns[pair])
            at = x.frame(row), y.frame(column)
            gap, direction = separation(x.part, at[0], y.part, at[1])
            strayed = x.strays_at(at[0], row) + y.strays_at(at[1], column)
            gap -= strayed
            self.least = min(self.least, gap)
            if gap >= limit:
                start = max(0, middle - _TOGETHER // 2)
                near = left[start : middle + _TOGETHER // 2]
                low = -_reach(y, columns[near], -direction)
                far = low - _reach(x, rows[near], direction) >= limit
                settled = np.zeros(len(left), dtype=np.bool_)
                settled[start : start + len(near)] = far
                if settled[middle]:
                    left = left[~settled]
                    continue
                settled[middle] = True
                left = left[~settled]
                gap, strayed = self._in_parts(x, y, (row, column), limit)
            if gap < limit:
                yield TooClose(pair, gap, strayed)
                left = left[alike[left] != alike[pair]]

    def _in_parts(
        self, x: Motion, y: Motion, pair: tuple[int, int], limit: float
    ) -> tuple[float, float]:
        """Return a gap below the limit somewhere in two pieces, infinity if none is, and strays."""
        if max(x.moved(pair[0]), y.moved(pair[1])) < _FINEST:
            return math.inf, 0.0
        fine_x, fine_y = x.finer(pair[0]), y.finer(pair[1])
        rows, columns = np.indices((len(fine_x), len(fine_y))).reshape(2, -1)
        one = np.zeros(len(rows), dtype=np.int64)
        found = self.too_close(fine_x, fine_y, (rows, columns), limit, one)
        return next(((gap, strayed) for _, gap, strayed in found), (math.inf, 0.0))


def _reach(motion: Motion, pieces: Indices, direction: np.ndarray) -> np.ndarray:
    once, where = np.unique(pieces, return_inverse=True)
    return np.asarray(motion.reach(once, direction)[where])
