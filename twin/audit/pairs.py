"""Pairs of shapes that could meet in a stretch, and the moments at which to measure them.

A pair is skipped as long as nothing can have happened: while the spheres around both shapes are
apart, and after each measurement until both together have moved as far as they were apart. So
the result is that of measuring every pair at every sample, with far fewer measurements.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from planning.transforms import Array, Indices
from twin.audit.bullet_world import AuditWorld, Shape, homogeneous, travel
from twin.audit.sampling import Stretch, load_frames

REACH = 0.05
"""Gaps are measured up to this (or to the least gap of two robots so far, plus this) [m]."""


@dataclass(frozen=True)
class Track:
    """A shape during a stretch of m samples.

    Attributes:
        shape: the shape.
        holder: index of the robot that moves it, None for a box at rest.
        link: index of the link it moves with, 0 for the base.
        rotation: shape (m, 3, 3), or (1, 3, 3) at rest.
        centre: of the sphere around it, shape (m, 3), or (1, 3) at rest [m].
        size: edge lengths of a box at rest, None for others.
    """

    shape: Shape
    holder: int | None
    link: int
    rotation: Array
    centre: Array
    size: Array | None = None


@dataclass(frozen=True)
class Gap:
    """The signed distance of two shapes from one sample on until something moves.

    Attributes:
        first, second: the shapes.
        sample: at which it was measured.
        until: sample from which on it may be another.
        distance: [m].
    """

    first: Shape
    second: Shape
    sample: int
    until: int
    distance: float


class _Watched:
    """A pair, the samples at which it may meet, and how far it has moved up to each sample."""

    def __init__(
        self, a: Track, b: Track, close: Indices, moved: Array, between_robots: bool
    ) -> None:
        self.a, self.b, self.close, self.moved = a, b, close, moved
        self.between_robots = between_robots

    def next_after(self, sample: int, room: float) -> tuple[int, int | None]:
        """Return when the pair has used up ``room`` [m], and when to measure it next."""
        used = self.moved[sample] + max(room, 0.0)
        until = int(np.searchsorted(self.moved, used, side="right"))
        k = int(np.searchsorted(self.close, until))
        return until, int(self.close[k]) if k < len(self.close) else None


def tracks_of(world: AuditWorld, stretch: Stretch) -> tuple[list[Track], list[Track]]:
    """Return the tracks of shapes moved by robots, and of those at rest, fixtures first."""
    moving = []
    for shape in world.robot_shapes:
        assert shape.robot is not None
        samples = stretch.robots[shape.robot]
        rotation = samples.rotation[:, shape.joint + 1]
        centre = rotation @ shape.centre + samples.position[:, shape.joint + 1]
        moving.append(Track(shape, shape.robot, shape.joint + 1, rotation, centre))
    resting = [
        Track(s, None, 0, f.pose[None, :3, :3], f.pose[None, :3, 3], f.size)
        for s, f in zip(world.fixtures, world.cell.fixtures, strict=True)
    ]
    robots = {robot.name: i for i, robot in enumerate(world.cell.robots)}
    for shape, box in zip(world.objects, world.cell.objects, strict=True):
        placement = stretch.placements.get(box.name)
        if placement is None:
            continue
        if placement.holder is None:
            rotation, centre = placement.pose[None, :3, :3], placement.pose[None, :3, 3]
            resting.append(Track(shape, None, 0, rotation, centre, box.size))
        else:
            index = robots[placement.holder]
            samples = stretch.robots[index]
            rotation, centre = load_frames(world, index, samples, placement.pose)
            moving.append(
                Track(shape, index, samples.position.shape[1] - 1, rotation, centre)
            )
    return moving, resting


def gaps(
    world: AuditWorld,
    stretch: Stretch,
    exempt: frozenset[tuple[int, int]],
    least: Callable[[], float],
) -> Iterator[Gap]:
    """Yield measured gaps of all pairs in the order of time.

    Every overlap is among them, and between robots every gap that is less than all before it.

    Args:
        world: placed anew at every sample.
        stretch: the piece of the run.
        exempt: pairs of one robot's shapes that are not checked, see ``overlapping_at_home``.
        least: the least gap between robots so far [m].
    """
    moving, resting = tracks_of(world, stretch)
    watched = list(_pairs(world, stretch, moving, resting, exempt, least()))
    due = [(int(pair.close[0]), k) for k, pair in enumerate(watched)]
    heapq.heapify(due)
    placer = _Placer(world, stretch, moving, resting)
    while due:
        sample, k = heapq.heappop(due)
        pair = watched[k]
        placer.go_to(sample)
        need = max(least(), 0.0) if pair.between_robots else 0.0
        reach = min(need, 10.0) + REACH
        distance = world.distance(pair.a.shape, pair.b.shape, reach)
        need = min(need, distance) if pair.between_robots else 0.0
        until, following = pair.next_after(sample, distance - max(need, 0.0))
        if following is not None:
            heapq.heappush(due, (following, k))
        yield Gap(pair.a.shape, pair.b.shape, sample, until, distance)


def _pairs(
    world: AuditWorld,
    stretch: Stretch,
    moving: list[Track],
    resting: list[Track],
    exempt: frozenset[tuple[int, int]],
    least: float,
) -> Iterator[_Watched]:
    count = len(stretch.t)
    arms = len(world.robot_shapes)
    travelled = [_travelled(track, count) for track in moving]
    low = np.array([track.centre.min(axis=0) for track in moving])
    high = np.array([track.centre.max(axis=0) for track in moving])
    radius = np.array([track.shape.radius for track in moving])
    for i, a in enumerate(moving):
        apart = np.maximum(np.maximum(low[i] - high, low - high[i]), 0.0)
        near = np.linalg.norm(apart, axis=1) <= radius[i] + radius + max(least, 0.0)
        for j in (np.flatnonzero(near[i + 1 :]) + i + 1).tolist():
            if (i, j) in exempt:
                continue
            b = moving[j]
            between_robots = a.holder != b.holder and j < arms
            room = a.shape.radius + b.shape.radius
            room += max(least, 0.0) if between_robots else 0.0
            close = np.linalg.norm(a.centre - b.centre, axis=1) <= room
            if np.any(close):
                if a.holder == b.holder:
                    moved = _travelled_within(a, b, count)
                else:
                    moved = travelled[i] + travelled[j]
                yield _Watched(a, b, np.flatnonzero(close), moved, between_robots)
    if not resting:
        return
    centre = np.array([track.centre[0] for track in resting])
    radius = np.array([track.shape.radius for track in resting])
    for i, a in enumerate(moving):
        gap = np.maximum(np.maximum(low[i] - centre, centre - high[i]), 0.0)
        near = np.linalg.norm(gap, axis=1) <= radius + a.shape.radius
        for j in np.flatnonzero(near).tolist():
            if a.link == 0 and i < arms:
                continue  # a base and a box at rest: nothing moves; bases stand on tables
            b = resting[j]
            close = _outside(b, a.centre) <= a.shape.radius
            if np.any(close):
                yield _Watched(a, b, np.flatnonzero(close), travelled[i], False)


def _outside(box: Track, points: Array) -> Array:
    """Return the distance of points, shape (m, 3), from a box at rest [m]."""
    assert box.size is not None
    local = (points - box.centre[0]) @ box.rotation[0]
    gap = np.maximum(np.abs(local) - 0.5 * box.size, 0.0)
    return np.asarray(np.linalg.norm(gap, axis=1))


def _travelled(track: Track, count: int) -> Array:
    out = np.zeros(count)
    if track.link > 0:
        np.cumsum(travel(track.rotation, track.centre, track.shape.radius), out=out[1:])
    return out


def _travelled_within(a: Track, b: Track, count: int) -> Array:
    """Return how far b has moved as seen from a, when one robot moves both."""
    out = np.zeros(count)
    if a.link != b.link:
        back = np.swapaxes(a.rotation, 1, 2)
        rotation = back @ b.rotation
        centre = np.einsum("kij,kj->ki", back, b.centre - a.centre)
        np.cumsum(travel(rotation, centre, b.shape.radius), out=out[1:])
        # Rounding must not look like motion where the robot stands.
        still = np.all(np.diff(a.rotation, axis=0) == 0.0, axis=(1, 2))
        still &= np.all(np.diff(b.rotation, axis=0) == 0.0, axis=(1, 2))
        if np.any(still):
            steps = np.where(still, 0.0, np.diff(out))
            np.cumsum(steps, out=out[1:])
    return out


class _Placer:
    """Puts robots and boxes where they are at a sample, touching only what has moved."""

    def __init__(
        self,
        world: AuditWorld,
        stretch: Stretch,
        moving: list[Track],
        resting: list[Track],
    ) -> None:
        self._world, self._stretch = world, stretch
        self._loads = moving[len(world.robot_shapes) :]
        self._at = [-1] * len(stretch.robots)
        for track in resting:
            world.place(
                track.shape.body, homogeneous(track.rotation[0], track.centre[0])
            )

    def go_to(self, sample: int) -> None:
        for index, samples in enumerate(self._stretch.robots):
            number = int(samples.distinct[sample])
            if number == self._at[index]:
                continue
            self._at[index] = number
            self._world.configure(index, samples.q[sample])
            for load in self._loads:
                if load.holder == index:
                    self._world.place(
                        load.shape.body,
                        homogeneous(load.rotation[sample], load.centre[sample]),
                    )
