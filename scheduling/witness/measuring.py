"""Distance bounds between moving bodies, from few exact distance computations.

Motions are divided into pieces. For two bodies that are apart in the middle of two pieces, coal gives a separating
direction. The extents of both bodies along this direction bound their distance in all pairs of pieces, which
settles most pairs. The remaining pairs are subdivided.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from planning.transforms import Array, Indices
from scheduling.witness.motion import Motion
from scheduling.witness.parts import separation

_FINEST = 1e-5
"""Motions that get no further than this are not cut [m]."""
PRECISION = 5e-5
"""Least distances are true to within this [m]."""
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
        count: distances measured so far.
    """

    def __init__(self) -> None:
        self.least, self.count = math.inf, 0

    def too_close(
        self,
        x: Motion,
        y: Motion,
        pairs: tuple[Indices, Indices],
        limit: float,
        alike: Indices,
        *,
        lockstep: bool = False,
    ) -> Iterator[TooClose]:
        """Yield pairs of pieces that come too close, with the measured distance.

        Args:
            x, y: the two parts.
            pairs: pieces of both, each of shape (k,).
            limit: clearance that they must keep [m].
            alike: of pairs with the same number only the first found is yielded, shape (k,).
            lockstep: whether both pieces of a pair begin and end at the same times, so that they
                are cut into parts of which only those of the same time meet; else any moment of
                one may be that of any of the other.
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
            self.least, self.count = min(self.least, gap), self.count + 1
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
                gap, strayed = self._in_parts(x, y, (row, column), limit, lockstep)
            if gap < limit:
                yield TooClose(pair, gap, strayed)
                left = left[alike[left] != alike[pair]]

    def closest(
        self,
        x: Motion,
        y: Motion,
        pairs: tuple[Indices, Indices],
        below: float,
        *,
        lockstep: bool = False,
    ) -> float:
        """Return the least distance of two parts in pairs of pieces, to within ``PRECISION`` [m].

        Args:
            x, y, pairs, lockstep: see ``too_close``.
            below: returned where they are nowhere nearer than this [m].
        """
        one = np.zeros(len(pairs[0]), dtype=np.int64)
        while True:
            limit = below - PRECISION + 2.0 * _FINEST
            found = self.too_close(x, y, pairs, limit, one, lockstep=lockstep)
            if (nearer := next(found, None)) is None:
                return below
            below = nearer.gap

    def _in_parts(
        self,
        x: Motion,
        y: Motion,
        pair: tuple[int, int],
        limit: float,
        lockstep: bool,
    ) -> tuple[float, float]:
        """Return a gap below the limit within two pieces, infinity if there is none, and deviation bounds."""
        if max(x.moved(pair[0]), y.moved(pair[1])) < _FINEST:
            return math.inf, 0.0
        fine_x, fine_y = x.finer(pair[0]), y.finer(pair[1])
        counts = len(fine_x), len(fine_y)
        rows, columns = np.indices(counts).reshape(2, -1)
        if lockstep and min(counts) > 1:  # one that stands has a single part
            rows = columns = np.arange(counts[0])
        one = np.zeros(len(rows), dtype=np.int64)
        parts = rows, columns
        found = self.too_close(fine_x, fine_y, parts, limit, one, lockstep=lockstep)
        return next(((gap, strayed) for _, gap, strayed in found), (math.inf, 0.0))


def _reach(motion: Motion, pieces: Indices, direction: Array) -> Array:
    if np.all(pieces[1:] > pieces[:-1]):
        return motion.reach(pieces, direction)
    once, where = np.unique(pieces, return_inverse=True)
    return np.asarray(motion.reach(once, direction)[where])
