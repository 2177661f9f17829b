"""Which moving shapes come near each other or boxes at rest, and at which samples.

Bounds of distances from below, many pairs at a time: between spheres, between upright boxes, and
from the box that is turned with a shape to the sphere around the other.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from planning.transforms import Array, Indices
from twin.audit.motion.standing import RestingBoxes
from twin.audit.motion.tracks import Track

_AT_ONCE = 400_000
"""So many pairs times samples are looked at at once, to bound memory."""


@dataclass(frozen=True)
class Movers:
    """The spheres and boxes around k moving shapes at m samples.

    Attributes:
        centre: shape (m, k, 3) [m].
        reach: half edges of upright boxes, shape (m, k, 3) [m].
        turn: rotations of boxes that are turned with the shapes, shape (m, k, 3, 3).
        half: their half edges, shape (k, 3) [m].
        radius: of the spheres, shape (k,) [m].
        moved: how far any point of a shape gets until the sample before or the one after,
            whichever is more, shape (m, k) [m].
        low, high: corners of the upright boxes around all the way, shape (k, 3) [m].
    """

    centre: Array
    reach: Array
    turn: Array
    half: Array
    radius: Array
    moved: Array
    low: Array
    high: Array

    def near_movers(
        self, first: Indices, second: Indices, room: Array
    ) -> Iterator[tuple[int, list[int]]]:
        """Yield which pairs may come nearer than some room, and at which samples.

        Args:
            first, second: the pairs, shape (p,).
            room: of each, besides what they move, shape (p,) [m].
        """
        most = self.moved.max(axis=0)
        apart = np.maximum(
            self.low[first] - self.high[second], self.low[second] - self.high[first]
        )
        coarse = room + most[first] + most[second]
        for some in self._parts(np.flatnonzero(_outside(apart) <= coarse)):
            i, j = first[some], second[some]
            away = self.centre[:, j] - self.centre[:, i]
            gap = np.sqrt(np.sum(away * away, axis=2)) - self.radius[i] - self.radius[j]
            upright = _outside(np.abs(away) - self.reach[:, i] - self.reach[:, j])
            limit = room[some] + self.moved[:, i] + self.moved[:, j]
            close = np.maximum(gap, upright) <= limit
            kept = np.flatnonzero(close.any(axis=0))
            if not len(kept):
                continue
            i, j, close, away = i[kept], j[kept], close[:, kept], away[:, kept]
            limit = limit[:, kept]
            close &= self._from_boxes(i, away) <= limit + self.radius[j]
            close &= self._from_boxes(j, away) <= limit + self.radius[i]
            yield from _each(some[kept], close)

    def near_boxes(
        self, movers: Indices, boxes: RestingBoxes
    ) -> Iterator[tuple[int, int, list[int]]]:
        """Yield which shapes may come near which boxes at rest, and at which samples.

        Args:
            movers: numbers of the shapes.
            boxes: at rest.
        """
        most = self.moved.max(axis=0)[movers, None]
        low, high = self.low[movers] - most, self.high[movers] + most
        least, greatest = boxes.centre - boxes.reach, boxes.centre + boxes.reach
        # Most boxes are far from all shapes.
        there = (greatest >= low.min(axis=0)) & (least <= high.max(axis=0))
        some = np.flatnonzero(there.all(axis=1))
        near = (low[:, None] <= greatest[some]) & (high[:, None] >= least[some])
        rows, columns = np.nonzero(near.all(axis=2))
        first, second = movers[rows], some[columns]
        for some in self._parts(np.arange(len(first))):
            i, b = first[some], second[some]
            away = boxes.centre[b] - self.centre[:, i]
            upright = _outside(np.abs(away) - self.reach[:, i] - boxes.reach[b])
            close = upright <= self.moved[:, i]
            kept = np.flatnonzero(close.any(axis=0))
            if not len(kept):
                continue
            i, b, close, away = i[kept], b[kept], close[:, kept], away[:, kept]
            close &= self._from_boxes(i, away) <= self.moved[:, i] + boxes.radius[b]
            for n, samples in _each(np.arange(len(kept)), close):
                yield int(i[n]), int(b[n]), samples

    def _parts(self, some: Indices) -> Iterator[Indices]:
        size = max(1, _AT_ONCE // len(self.centre))
        for start in range(0, len(some), size):
            yield some[start : start + size]

    def _from_boxes(self, shapes: Indices, away: Array) -> Array:
        """Return how far points are from the turned boxes of shapes, shape (m, p) [m].

        Args:
            shapes: p of them.
            away: of a point from the centre of each, or the other way round, shape (m, p, 3).
        """
        local = np.einsum("mpi,mpij->mpj", away, self.turn[:, shapes])
        return _outside(np.abs(local) - self.half[shapes])


def movers_of(tracks: Sequence[Track], samples: slice) -> Movers:
    """Return the spheres and boxes around moving shapes at some samples."""
    centre = np.stack([track.centre[samples] for track in tracks], axis=1)
    reach = np.stack([track.reach[samples] for track in tracks], axis=1)
    steps = np.stack([np.append(track.steps, 0.0)[samples] for track in tracks], axis=1)
    before = np.concatenate([np.zeros((1, len(tracks))), steps[:-1]])
    return Movers(
        centre,
        reach,
        np.stack([track.turn[samples] for track in tracks], axis=1),
        np.array([track.shape.half for track in tracks]),
        np.array([track.shape.radius for track in tracks]),
        np.maximum(steps, before),
        (centre - reach).min(axis=0),
        (centre + reach).max(axis=0),
    )


def _outside(apart: Array) -> Array:
    """Return the length of what is apart along axes, 0 where nothing is, shape (..., 3) [m]."""
    gap = np.maximum(apart, 0.0)
    return np.asarray(np.sqrt(np.sum(gap * gap, axis=-1)))


def _each(
    numbers: Indices, close: npt.NDArray[np.bool_]
) -> Iterator[tuple[int, list[int]]]:
    """Yield the columns in which anything is close, with the rows."""
    rows, columns = np.nonzero(close.T)
    ends = np.flatnonzero(np.diff(rows)) + 1
    for part_rows, part in zip(
        np.split(rows, ends), np.split(columns, ends), strict=True
    ):
        if len(part):
            yield int(numbers[part_rows[0]]), part.tolist()
