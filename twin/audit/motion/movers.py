"""Which moving shapes come near each other or boxes at rest, and at which samples.

Bounds of distances from below, many pairs at a time: between spheres, between upright boxes, and
from the box that is turned with a shape to the sphere around the other.

Fixtures and objects at rest, kept from stretch to stretch: only what changes hands is worked out anew.

States of robots between the rows of a table: configurations, speeds, accelerations at any time.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from planning.transforms import Array, Indices, Transform
from twin.audit.motion.executed import ObjectRow, RobotRows, Track
from twin.audit.worlds.world import AuditWorld, WatchedShape

_STILL = np.zeros((0, 1))


@dataclass(frozen=True)
class RestingBoxes:
    """Fixtures, and objects at rest.

    Attributes:
        tracks: of the shapes of the fixtures, then of the objects.
        centre: of the shapes, shape (b, 3) [m].
        reach: half edges of the upright boxes around them, shape (b, 3) [m].
        radius: of the spheres around them, shape (b,) [m].
    """

    tracks: Sequence[Track]
    centre: Array
    reach: Array
    radius: Array


class StandingTable:
    """Table of the fixtures, and of the objects that are at rest now.

    Args:
        world: the cell.
    """

    def __init__(self, world: AuditWorld) -> None:
        shapes = [*world.fixtures, *world.objects]
        self._shapes: dict[str, list[tuple[int, WatchedShape]]] = {}
        for k, shape in enumerate(shapes):
            self._shapes.setdefault(shape.entity, []).append((k, shape))
        self._tracks: list[Track | None] = [None] * len(shapes)
        self._centre = np.zeros((len(shapes), 3))
        self._reach = np.zeros((len(shapes), 3))
        self._radius = np.array([shape.radius for shape in shapes])
        for item in world.cell.fixtures:
            for k, shape in self._shapes[item.name]:
                self._put(k, shape, shape.at(item.pose))

    def put(self, row: ObjectRow) -> None:
        """Take over where an object is from now on."""
        for k, shape in self._shapes[row.object]:
            if row.holder is None:
                self._put(k, shape, shape.at(row.pose))
            else:
                self._tracks[k] = None

    def boxes(self) -> RestingBoxes:
        """Return what stands now."""
        there = [k for k, track in enumerate(self._tracks) if track is not None]
        return RestingBoxes(
            [track for track in self._tracks if track is not None],
            self._centre[there],
            self._reach[there],
            self._radius[there],
        )

    def _put(self, k: int, shape: WatchedShape, pose: Transform) -> None:
        rotation, centre = pose[None, :3, :3], pose[None, :3, 3]
        reach = np.abs(rotation) @ shape.half
        self._tracks[k] = Track(
            shape, None, 0, rotation, centre, rotation, reach, _STILL, pose
        )
        self._centre[k], self._reach[k] = centre[0], reach[0]


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


_SAMPLE_S = 0.01
"""So often a robot is looked at, at least, while it moves [s]."""


def moving_samples(rows: RobotRows, begin: float, end: float) -> Array:
    """Return the times of all rows in a span, its ends, and more while the robot moves."""
    low, high = np.searchsorted(rows.t, [begin, end])
    knots = np.unique(np.concatenate([[begin], rows.t[low:high], [end]]))
    assert rows.v is not None
    moves = np.any(rows.v != 0.0, axis=1)
    parts = [knots]
    for a, b in pairwise(knots.tolist()):
        k = int(np.searchsorted(rows.t, a, side="right"))
        if moves[max(k - 1, 0)] or moves[min(k, len(moves) - 1)]:
            count = int(np.ceil((b - a) / _SAMPLE_S))
            parts.append(np.linspace(a, b, count + 1)[1:-1])
    return np.unique(np.concatenate(parts))


def states_at(rows: RobotRows, t: Array) -> tuple[Array, Array, Array]:
    """Return configurations, speeds and accelerations at some times, shape (m, n) each."""
    assert rows.v is not None
    assert rows.a is not None
    k = np.clip(np.searchsorted(rows.t, t, side="right") - 1, 0, len(rows.t) - 2)
    span, since = (rows.t[k + 1] - rows.t[k])[:, None], (t - rows.t[k])[:, None]
    jerk = (rows.a[k + 1] - rows.a[k]) / span
    v = rows.v[k] + since * (rows.a[k] + 0.5 * since * jerk)
    return rows.at(t), v, rows.a[k] + since * jerk
