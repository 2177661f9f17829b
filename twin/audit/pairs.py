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
from twin.audit.bullet_world import AuditWorld, Shape
from twin.audit.sampling import Stretch, Track, travel

REACH = 0.05
"""Gaps are measured up to this (or to the least gap of two robots so far, plus this) [m]."""


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


@dataclass(frozen=True)
class _Watched:
    """A pair, the samples at which it may meet, and how far it has moved up to each sample."""

    a: Track
    b: Track
    close: Indices
    moved: Array
    between_robots: bool

    def next_after(self, sample: int, room: float) -> tuple[int, int | None]:
        """Return when the pair has used up ``room`` [m], and when to measure it next."""
        used = self.moved[sample] + max(room, 0.0)
        until = int(np.searchsorted(self.moved, used, side="right"))
        k = int(np.searchsorted(self.close, until))
        return until, int(self.close[k]) if k < len(self.close) else None


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
    watched = list(_pairs(stretch, len(world.robot_shapes), exempt, least()))
    due = [(int(pair.close[0]), k) for k, pair in enumerate(watched)]
    heapq.heapify(due)
    placer = _Placer(world, stretch)
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
    stretch: Stretch, arms: int, exempt: frozenset[tuple[int, int]], least: float
) -> Iterator[_Watched]:
    """Yield the pairs that come near each other; the first ``arms`` tracks are of robots."""
    tracks = [*stretch.moving, *stretch.resting]
    if not tracks:
        return
    travelled = [np.append(0.0, np.cumsum(track.steps)) for track in stretch.moving]
    low = np.array([track.centre.min(axis=0) for track in tracks])
    high = np.array([track.centre.max(axis=0) for track in tracks])
    radius = np.array([track.shape.radius for track in tracks])
    watched = max(least, 0.0)  # how far apart robots are of interest
    reach = radius + np.where(np.arange(len(tracks)) < arms, watched, 0.0)
    for i, a in enumerate(stretch.moving):
        apart = np.maximum(np.maximum(low[i] - high, low - high[i]), 0.0)
        near = np.linalg.norm(apart, axis=1) <= radius[i] + reach
        for j in (np.flatnonzero(near[i + 1 :]) + i + 1).tolist():
            b = tracks[j]
            rests = b.holder is None
            # A base and a box at rest: nothing moves; bases stand on tables.
            if (i, j) in exempt or (rests and a.link == 0 and i < arms):
                continue
            between_robots = a.holder != b.holder and j < arms
            room = a.shape.radius
            if rests:
                distance = _outside(b, a.centre)
            else:
                distance = np.linalg.norm(a.centre - b.centre, axis=1)
                room += b.shape.radius + (watched if between_robots else 0.0)
            close = np.flatnonzero(distance <= room)
            if not len(close):
                continue
            if rests:
                moved = travelled[i]
            elif a.holder == b.holder:
                moved = _travelled_within(a, b)
            else:
                moved = travelled[i] + travelled[j]
            yield _Watched(a, b, close, moved, between_robots)


def _outside(box: Track, points: Array) -> Array:
    """Return the distance of points, shape (m, 3), from a box at rest [m]."""
    assert box.size is not None
    local = (points - box.centre[0]) @ box.rotation[0]
    gap = np.maximum(np.abs(local) - 0.5 * box.size, 0.0)
    return np.asarray(np.linalg.norm(gap, axis=1))


def _travelled_within(a: Track, b: Track) -> Array:
    """Return how far b has moved as seen from a, when one robot moves both."""
    if a.link == b.link:
        return np.zeros(len(b.centre))
    back = np.swapaxes(a.rotation, 1, 2)
    centre = np.einsum("kij,kj->ki", back, b.centre - a.centre)
    steps = travel(back @ b.rotation, centre, b.shape.radius)
    # Rounding must not look like motion where the robot stands.
    still = np.all(np.diff(a.rotation, axis=0) == 0.0, axis=(1, 2))
    still &= np.all(np.diff(b.rotation, axis=0) == 0.0, axis=(1, 2))
    return np.append(0.0, np.cumsum(np.where(still, 0.0, steps)))


class _Placer:
    """Puts robots and boxes where they are at a sample, touching only what has moved."""

    def __init__(self, world: AuditWorld, stretch: Stretch) -> None:
        self._world, self._stretch = world, stretch
        self._loads = stretch.moving[len(world.robot_shapes) :]
        self._at = [-1] * len(stretch.robots)
        for track in stretch.resting:
            world.place(track.shape.body, track.pose(0))

    def go_to(self, sample: int) -> None:
        for index, samples in enumerate(self._stretch.robots):
            number = int(samples.distinct[sample])
            if number == self._at[index]:
                continue
            self._at[index] = number
            self._world.configure(index, samples.q[sample])
            for load in self._loads:
                if load.holder == index:
                    self._world.place(load.shape.body, load.pose(sample))
