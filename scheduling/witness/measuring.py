"""Distances of parts in motion: few are measured, and each settles many pairs of pieces.

Where two parts are apart in the middle of two pieces, coal says in which direction. How far both reach in that
direction bounds the distance in all of their pieces at once, and most of them are settled by that. What is left is
cut finer.
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


def _reach(motion: Motion, pieces: Indices, direction: Array) -> Array:
    once, where = np.unique(pieces, return_inverse=True)
    return np.asarray(motion.reach(once, direction)[where])
