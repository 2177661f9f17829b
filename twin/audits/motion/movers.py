"""Broad phase: moving shapes near each other or near boxes at rest, by sample.

Lower bounds of distances for many pairs: between spheres, between axis-aligned boxes, and from the
oriented box of a shape to the sphere around the other.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from planning.transforms import Array, Indices, Transform
from scheduling.witness.robot import WitnessRobot
from twin.audits.motion.executed import Stay
from twin.audits.motion.reach import RobotSamples, motion_bounds
from twin.audits.worlds.world import AuditWorld, WatchedShape

_AT_ONCE = 400_000
"""Pairs times samples processed together, to bound memory."""


@dataclass(frozen=True, eq=False)
class Track:
    """A shape and the link it moves with.

    Attributes:
        shape: the shape.
        holder: index of the robot that moves it, None at rest.
        link: index of the link it moves with, 0 for the base.
        pose: of it in the frame of its link, None of a robot's own; in the world, at rest.
    """

    shape: WatchedShape
    holder: int | None
    link: int
    pose: Transform | None


@dataclass(frozen=True)
class Movers:
    """The spheres and boxes around k moving shapes at m samples.

    Attributes:
        tracks: of the shapes.
        centre: shape (m, k, 3) [m].
        turn: rotations of boxes that are turned with the shapes, shape (m, k, 3, 3).
        reach: half edges of upright boxes, shape (m, k, 3) [m].
        half: half edges of the turned boxes, shape (k, 3) [m].
        radius: of the spheres, shape (k,) [m].
        bounds: how far any point of a shape gets at most from sample to sample, as seen from the
            base and each moved link of its robot, shape (m - 1, k, links) [m].
    """

    tracks: Sequence[Track]
    centre: Array
    turn: Array
    reach: Array
    half: Array
    radius: Array
    bounds: Array

    @cached_property
    def steps(self) -> Array:
        """Travel bound of any point of a shape, per step, shape (m - 1, k) [m]."""
        return np.asarray(self.bounds[:, :, 0])

    @cached_property
    def moved(self) -> Array:
        """Travel bound of any point of a shape to the previous or next sample, (m, k) [m]."""
        steps = np.pad(self.steps, ((1, 1), (0, 0)))
        return np.maximum(steps[:-1], steps[1:])[: len(self.centre)]

    @cached_property
    def low(self) -> Array:
        """Lower corners of the axis-aligned boxes around the whole motion, shape (k, 3) [m]."""
        return np.asarray((self.centre - self.reach).min(axis=0))

    @cached_property
    def high(self) -> Array:
        """Upper corners of those boxes, shape (k, 3) [m]."""
        return np.asarray((self.centre + self.reach).max(axis=0))

    def at_first(self) -> Movers:
        """Return the same at the first sample alone."""
        first = {key: getattr(self, key)[:1] for key in ("centre", "turn", "reach")}
        return replace(self, **first)

    def near_movers(
        self, first: Indices, second: Indices, room: Array
    ) -> Iterator[tuple[int, list[int]]]:
        """Yield pairs that may come nearer than a distance, with samples.

        Args:
            first, second: the pairs, shape (p,).
            room: distance of each pair, in addition to travel, shape (p,) [m].
        """
        most = self.moved.max(axis=0)
        apart = np.maximum(
            self.low[first] - self.high[second], self.low[second] - self.high[first]
        )
        coarse = room + most[first] + most[second]
        some = np.flatnonzero(_outside(apart) <= coarse)
        for n, samples in self._near(first[some], self, second[some], room[some]):
            yield int(some[n]), samples

    def near_boxes(
        self, movers: Indices, boxes: Movers
    ) -> Iterator[tuple[int, int, list[int]]]:
        """Yield shapes that may come near boxes at rest, with samples.

        Args:
            movers: numbers of the shapes.
            boxes: at rest.
        """
        most = self.moved.max(axis=0)[movers, None]
        low, high = self.low[movers] - most, self.high[movers] + most
        # Most boxes are far from all shapes.
        there = (boxes.high >= low.min(axis=0)) & (boxes.low <= high.max(axis=0))
        some = np.flatnonzero(there.all(axis=1))
        near = (low[:, None] <= boxes.high[some]) & (high[:, None] >= boxes.low[some])
        rows, columns = np.nonzero(near.all(axis=2))
        first, second = movers[rows], some[columns]
        for n, samples in self._near(first, boxes, second, np.zeros(len(first))):
            yield int(first[n]), int(second[n]), samples

    def _near(
        self, first: Indices, other: Movers, second: Indices, room: Array
    ) -> Iterator[tuple[int, list[int]]]:
        """Yield near pairs with other movers, of as many samples or one."""
        for some in self._parts(len(first)):
            i, j = first[some], second[some]
            away = other.centre[:, j] - self.centre[:, i]
            reach = self.radius[i] + other.radius[j]
            gap = np.sqrt(np.sum(away * away, axis=2)) - reach
            upright = _outside(np.abs(away) - self.reach[:, i] - other.reach[:, j])
            limit = room[some] + self.moved[:, i] + other.moved[:, j]
            close = np.maximum(gap, upright) <= limit
            kept = np.flatnonzero(close.any(axis=0))
            if not len(kept):
                continue
            i, j, close, away = i[kept], j[kept], close[:, kept], away[:, kept]
            limit = limit[:, kept]
            close &= self._from_boxes(i, away) <= limit + other.radius[j]
            close &= other._from_boxes(j, away) <= limit + self.radius[i]
            rows, columns = np.nonzero(close.T)
            ends = np.flatnonzero(np.diff(rows)) + 1
            parts = np.split(rows, ends), np.split(columns, ends)
            for part_rows, samples in zip(*parts, strict=True):
                if len(samples):
                    yield int(some[kept[part_rows[0]]]), samples.tolist()

    def _parts(self, count: int) -> Iterator[Indices]:
        size = max(1, _AT_ONCE // len(self.centre))
        for start in range(0, count, size):
            yield np.arange(start, min(start + size, count))

    def _from_boxes(self, shapes: Indices, away: Array) -> Array:
        """Return distances of points from the oriented boxes of shapes, shape (m, p) [m].

        Args:
            shapes: p of them.
            away: of a point from the centre of each, or the other way round, shape (m, p, 3).
        """
        local = np.einsum("mpi,mpij->mpj", away, self.turn[:, shapes])
        return _outside(np.abs(local) - self.half[shapes])


class StandingTable:
    """Table of fixtures and objects at rest, updated incrementally.

    Args:
        world: the cell.
    """

    def __init__(self, world: AuditWorld) -> None:
        shapes = [*world.fixtures, *world.objects]
        self._shapes: dict[str, list[tuple[int, WatchedShape]]] = {}
        for k, shape in enumerate(shapes):
            self._shapes.setdefault(shape.entity, []).append((k, shape))
        self._tracks: list[Track | None] = [None] * len(shapes)
        self._centre, self._reach = np.zeros((2, len(shapes), 3))
        self._turn = np.zeros((len(shapes), 3, 3))
        self._half = np.array([shape.half for shape in shapes]).reshape(-1, 3)
        self._radius = np.array([shape.radius for shape in shapes])
        self._placements: Mapping[str, Stay] = {}
        for item in world.cell.fixtures:
            self._put(item.name, item.pose)

    def change(self, placements: Mapping[str, Stay]) -> None:
        """Update the poses of objects."""
        for name, stay in placements.items():
            if self._placements.get(name) is not stay:
                self._put(name, None if stay.holder is not None else stay.pose)
        for name in self._placements.keys() - placements.keys():
            self._put(name, None)
        self._placements = placements

    def boxes(self) -> Movers:
        """Return the boxes at rest, at one sample."""
        there = [k for k, track in enumerate(self._tracks) if track is not None]
        return Movers(
            [track for track in self._tracks if track is not None],
            self._centre[None, there],
            self._turn[None, there],
            self._reach[None, there],
            self._half[there],
            self._radius[there],
            np.zeros((0, len(there), 1)),
        )

    def _put(self, name: str, pose: Transform | None) -> None:
        for k, shape in self._shapes[name]:
            self._tracks[k] = None
            if pose is not None:
                at = shape.at(pose)
                self._tracks[k] = Track(shape, None, 0, at)
                self._centre[k], self._turn[k] = at[:3, 3], at[:3, :3]
                self._reach[k] = np.abs(at[:3, :3]) @ shape.half


class MovedShapes:
    """Shapes moved by one robot: its own, then those of held objects.

    Args:
        robot: its index.
        own: its shapes.
        held: shapes of held objects, each with its pose in the hand frame.
        hand: index of the link that they move with.

    Attributes:
        tracks: of the shapes.
    """

    def __init__(
        self,
        robot: int,
        own: Sequence[WatchedShape],
        held: Sequence[tuple[WatchedShape, Transform]],
        hand: int,
    ) -> None:
        self.tracks = [
            *(Track(shape, robot, shape.joint + 1, None) for shape in own),
            *(Track(shape, robot, hand, pose) for shape, pose in held),
        ]
        at = [(track.shape, track.pose) for track in self.tracks]
        centres = [s.centre if pose is None else pose[:3, 3] for s, pose in at]
        turns = [s.turn if pose is None else pose[:3, :3] @ s.turn for s, pose in at]
        self._links = np.array([track.link for track in self.tracks], dtype=np.int64)
        self._centre = np.array(centres).reshape(-1, 3)
        self._turn = np.array(turns).reshape(-1, 3, 3)
        self._half = np.array([shape.half for shape, _ in at]).reshape(-1, 3)
        self._radius = np.array([shape.radius for shape, _ in at])

    def sampled(self, robot: WitnessRobot, samples: RobotSamples) -> Movers:
        """Return them at some samples of the robot."""
        rotation = samples.rotation[:, self._links]
        centre = np.einsum("msij,sj->msi", rotation, self._centre)
        centre += samples.position[:, self._links]
        turn = rotation @ self._turn
        reach = np.einsum("msij,sj->msi", np.abs(turn), self._half)
        bounds = motion_bounds(robot, samples, self._links, centre, self._radius)
        around = reach, self._half, self._radius
        return Movers(self.tracks, centre, turn, *around, bounds)


def joined_movers(parts: Sequence[Movers], order: Sequence[int]) -> Movers:
    """Return the shapes of all robots in an order."""
    tracks = [track for part in parts for track in part.tracks]
    links = max(part.bounds.shape[2] for part in parts)
    bounds = [
        np.pad(part.bounds, ((0, 0), (0, 0), (0, links - part.bounds.shape[2])))
        for part in parts
    ]

    def joined(arrays: Sequence[Array], axis: int) -> Array:
        return np.take(np.concatenate(arrays, axis=axis), order, axis=axis)

    return Movers(
        [tracks[k] for k in order],
        joined([part.centre for part in parts], 1),
        joined([part.turn for part in parts], 1),
        joined([part.reach for part in parts], 1),
        joined([part.half for part in parts], 0),
        joined([part.radius for part in parts], 0),
        joined(bounds, 1),
    )


def _outside(apart: Array) -> Array:
    """Return the norm of positive separations along axes, shape (..., 3) [m]."""
    gap = np.maximum(apart, 0.0)
    return np.asarray(np.sqrt(np.sum(gap * gap, axis=-1)))
