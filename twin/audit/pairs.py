"""Pairs of shapes that could meet in a stretch, and the moments at which to measure them.

A pair is skipped as long as nothing can have happened: while the spheres around both shapes are
apart, and after each measurement until both together have moved as far as they were apart. Between
two measurements a pair is no nearer than half of what is left of both distances when the motion in
between is taken off. Where that does not exclude contact, or a new least distance of two robots,
it is measured in the middle, and so on until the motion left is ``FINEST``. So every moment is
accounted for, with far fewer measurements than samples.
"""

from __future__ import annotations

import heapq
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import ceil

import numpy as np

from planning.transforms import Array, Transform
from twin.audit.sampling import STEP, Stretch, Track
from twin.audit.worlds.world import AuditWorld, Shape

REACH = 0.5
"""Gaps are measured up to this (or to the least gap of two robots so far, plus this) [m]."""

FINEST = 1e-4
"""Motion of a pair that is not divided further: gaps are true to within half of it [m]."""


@dataclass(frozen=True)
class Gap:
    """The signed distance of two shapes from one sample on until something moves.

    Attributes:
        first, second: the shapes.
        sample: at which it was measured, or the last one before.
        until: sample from which on it may be another.
        distance: [m].
        bound: less than this it cannot have been since the measurement before, where that is
            less than asked for; else ``distance`` [m].
    """

    first: Shape
    second: Shape
    sample: int
    until: int
    distance: float
    bound: float


@dataclass(frozen=True)
class Asked:
    """What gaps are held against.

    Attributes:
        least: returns the least gap between robots so far [m].
        depth: returns the overlap that is allowed for two shapes at a sample [m].
    """

    least: Callable[[], float]
    depth: Callable[[Shape, Shape, int], float]


@dataclass(frozen=True)
class _Watched:
    """A pair, the samples at which it may meet, and how far it has moved up to each sample."""

    a: Track
    b: Track
    close: list[int]
    moved: list[float]
    between_robots: bool

    def next_after(self, sample: int, room: float) -> tuple[int, int | None]:
        """Return when the pair has used up ``room`` [m], and when to measure it next."""
        used = self.moved[sample] + max(room, 0.0)
        until = bisect_right(self.moved, used, sample)
        k = bisect_left(self.close, until)
        return until, self.close[k] if k < len(self.close) else None

    def middle(self, start: float, end: float, used: float) -> float:
        """Return where between two places, in samples, the pair has moved by ``used`` [m]."""
        first, last = int(start), ceil(end)
        k = bisect_right(self.moved, used, first + 1, last) - 1
        share = (used - self.moved[k]) / (self.moved[k + 1] - self.moved[k])
        return k + min(share, 1.0)


@dataclass(frozen=True)
class _Measured:
    """A measurement: where, in samples, how far the pair had moved, and its distance [m]."""

    at: float
    moved: float
    distance: float


def gaps(
    world: AuditWorld,
    stretch: Stretch,
    exempt: frozenset[tuple[int, int]],
    asked: Asked,
) -> Iterator[Gap]:
    """Yield measured gaps that matter, those at samples first, then those in between.

    Every overlap deeper than allowed is among them, and between robots every gap that is less
    than all before it, both to within half of ``FINEST``.

    Args:
        world: placed anew at every sample.
        stretch: the piece of the run.
        exempt: pairs of one robot's shapes that are not checked, see ``overlapping_at_home``.
        asked: what must be excluded.
    """
    least = asked.least
    stands = all(r.distinct[0] == r.distinct[-1] for r in stretch.robots)
    find = _standing_pairs if stands else _pairs
    watched = list(find(stretch, len(world.robot_shapes), exempt, least()))
    due = [(pair.close[0], k) for k, pair in enumerate(watched)]
    heapq.heapify(due)
    before: list[_Measured | None] = [None] * len(watched)
    placer = _Placer(world, stretch)
    between, near = _Between(placer, asked, True), _Between(placer, asked, False)
    while due:
        sample, k = heapq.heappop(due)
        pair = watched[k]
        distance = _measure(placer, pair, float(sample), least())
        need = max(least(), 0.0) if pair.between_robots else 0.0
        need = min(need, distance) if pair.between_robots else 0.0
        until, following = pair.next_after(sample, distance - max(need, 0.0))
        if following is not None:
            heapq.heappush(due, (following, k))
        if distance <= 0.0 or (pair.between_robots and distance < least()):
            yield Gap(pair.a.shape, pair.b.shape, sample, until, distance, distance)
        now = _Measured(float(sample), pair.moved[sample], distance)
        last = before[k]
        if last is not None:
            # When the whole stretch has been measured, few of them are still open.
            (between if pair.between_robots else near).add(pair, last, now)
        # Where the pair is not close in between, its spheres have been apart since.
        before[k] = now if following == until else None
    yield from between.settle()
    yield from near.settle()


def _measure(placer: _Placer, pair: _Watched, at: float, least: float) -> float:
    placer.go_to(at)
    need = max(least, 0.0) if pair.between_robots else 0.0
    reach = min(need, 10.0) + REACH
    return placer.world.distance(pair.a.shape, pair.b.shape, reach)


class _Between:
    """What lies between measurements and excludes too little yet, in the order to settle it.

    Between robots the worst comes first, which settles the most of what is left; of others the
    earliest, so that what is measured at the same moment is placed once.
    """

    def __init__(self, placer: _Placer, asked: Asked, worst_first: bool) -> None:
        self._placer, self._asked, self._worst_first = placer, asked, worst_first
        self._open: list[tuple[float, int, float, _Watched, _Measured, _Measured]] = []
        self._count = 0

    def add(self, pair: _Watched, low: _Measured, high: _Measured) -> None:
        """Note two measurements of a pair."""
        bound = 0.5 * (low.distance + high.distance - (high.moved - low.moved))
        if bound >= 0.0 and not pair.between_robots:
            return
        if bound < _needed(pair, low, high, self._asked):
            self._count += 1
            first = bound if self._worst_first else 0.5 * (low.at + high.at)
            heapq.heappush(self._open, (first, self._count, bound, pair, low, high))

    def settle(self) -> Iterator[Gap]:
        """Measure in between until nothing that is asked for is left open."""
        while self._open:
            _, _, bound, pair, low, high = heapq.heappop(self._open)
            if bound >= _needed(pair, low, high, self._asked):
                continue
            a, b = pair.a.shape, pair.b.shape
            if high.moved - low.moved <= FINEST:
                nearest = min(low.distance, high.distance)
                yield Gap(a, b, int(low.at), int(low.at) + 1, nearest, bound)
                continue
            used = 0.5 * (low.moved + high.moved)
            at = pair.middle(low.at, high.at, used)
            distance = _measure(self._placer, pair, at, self._asked.least())
            if distance <= 0.0 or pair.between_robots:
                yield Gap(a, b, int(at), int(at) + 1, distance, distance)
            middle = _Measured(at, used, distance)
            self.add(pair, low, middle)
            self.add(pair, middle, high)


def _needed(pair: _Watched, low: _Measured, high: _Measured, asked: Asked) -> float:
    """Return the distance that must be kept between two measurements [m]."""
    nearest = min(low.distance, high.distance)
    if pair.between_robots:
        least = asked.least()
        return least if nearest <= 0.0 else max(least, 0.0)
    if nearest - (high.moved - low.moved) >= 0.0:
        return 0.0
    shapes = pair.a.shape, pair.b.shape
    last = min(ceil(high.at), len(pair.moved) - 1)
    depth = min(asked.depth(*shapes, int(low.at)), asked.depth(*shapes, last))
    return -depth if nearest >= -depth else -np.inf


def _pairs(
    stretch: Stretch, arms: int, exempt: frozenset[tuple[int, int]], least: float
) -> Iterator[_Watched]:
    """Yield the pairs that come near each other; the first ``arms`` tracks are of robots."""
    tracks = [*stretch.moving, *stretch.resting]
    if not tracks:
        return
    travelled = [np.append(0.0, np.cumsum(track.steps)) for track in stretch.moving]
    # What is apart by this at two samples is apart all the time between them.
    both = 2.0 * STEP
    low = np.array([track.centre.min(axis=0) for track in tracks])
    high = np.array([track.centre.max(axis=0) for track in tracks])
    radius = np.array([track.shape.radius for track in tracks])
    watched = max(least, 0.0)  # how far apart robots are of interest
    reach = radius + np.where(np.arange(len(tracks)) < arms, watched, 0.0)
    for i, a in enumerate(stretch.moving):
        apart = np.maximum(np.maximum(low[i] - high, low - high[i]), 0.0)
        near = np.linalg.norm(apart, axis=1) <= radius[i] + reach + both
        for j in (np.flatnonzero(near[i + 1 :]) + i + 1).tolist():
            b = tracks[j]
            rests = b.holder is None
            # A base and a box at rest: nothing moves; bases stand on tables.
            if (i, j) in exempt or (rests and a.link == 0 and i < arms):
                continue
            between_robots = a.holder != b.holder and j < arms
            room = a.shape.radius + both
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
            yield _Watched(a, b, close.tolist(), moved.tolist(), between_robots)


def _standing_pairs(
    stretch: Stretch, arms: int, exempt: frozenset[tuple[int, int]], least: float
) -> Iterator[_Watched]:
    """Yield the pairs that are near each other in a stretch in which nothing moves."""
    tracks, count = [*stretch.moving, *stretch.resting], len(stretch.moving)
    if not count:
        return
    centre = np.array([track.centre[0] for track in tracks])
    radius = np.array([track.shape.radius for track in tracks])
    reach = radius[:count, None] + radius[:count]
    holder = np.array([-1 if t.holder is None else t.holder for t in tracks[:count]])
    arm = np.arange(count) < arms
    between = (holder[:, None] != holder) & arm
    gap = np.linalg.norm(centre[:count, None] - centre[:count], axis=2)
    near = np.triu(gap <= reach + np.where(between, max(least, 0.0), 0.0), 1)
    still = [0.0] * len(stretch.t)
    for i, j in np.argwhere(near).tolist():
        if (i, j) not in exempt:
            a, b = tracks[i], tracks[j]
            yield _Watched(a, b, [0], still, bool(between[i, j]))
    free = np.flatnonzero(
        [not (k < arms and t.link == 0) for k, t in enumerate(tracks[:count])]
    )
    for b in stretch.resting:
        beside = _outside(b, centre[free]) <= radius[free]
        for i in free[beside].tolist():
            yield _Watched(tracks[i], b, [0], still, False)


def _outside(box: Track, points: Array) -> Array:
    """Return the distance of points, shape (m, 3), from a box at rest [m]."""
    assert box.size is not None
    local = (points - box.centre[0]) @ box.rotation[0]
    gap = np.maximum(np.abs(local) - 0.5 * box.size, 0.0)
    return np.asarray(np.linalg.norm(gap, axis=1))


def _travelled_within(a: Track, b: Track) -> Array:
    """Return how far one has moved as seen from the other, when one robot moves both."""
    inner, outer = (a, b) if a.link <= b.link else (b, a)
    return np.append(0.0, np.cumsum(outer.moved[:, inner.link]))


class _Placer:
    """Puts robots and boxes where they are at some time, touching only what has moved."""

    def __init__(self, world: AuditWorld, stretch: Stretch) -> None:
        self.world, self._stretch = world, stretch
        self._loads = stretch.moving[len(world.robot_shapes) :]
        self._at = [(-1, 0.0)] * len(stretch.robots)
        for track in stretch.resting:
            world.place(track.shape, track.pose(0))

    def go_to(self, at: float) -> None:
        """Place everything as it is at a sample, or between it and the next."""
        k = int(at)
        for index, samples in enumerate(self._stretch.robots):
            number = int(samples.distinct[k])
            share = at - k
            if share > 0.0 and int(samples.distinct[k + 1]) == number:
                share = 0.0
            if (number, share) == self._at[index]:
                continue
            self._at[index] = (number, share)
            q = samples.q[k]
            if share > 0.0:
                q = q + share * (samples.q[k + 1] - q)
            self.world.configure(index, q)
            for load in self._loads:
                if load.holder == index:
                    self.world.place(load.shape, self._pose(load, k, share, q))

    def _pose(self, load: Track, k: int, share: float, q: Array) -> Transform:
        """Return the pose of an object in the hand, at a sample or after it."""
        pose = load.pose(k)
        if share > 0.0:
            assert load.holder is not None
            samples = self._stretch.robots[load.holder]
            rotation, position = self.world.link_frames(load.holder, q[None])
            turn = rotation[0, load.link] @ samples.rotation[k, load.link].T
            arm = pose[:3, 3] - samples.position[k, load.link]
            pose[:3, :3] = turn @ pose[:3, :3]
            pose[:3, 3] = turn @ arm + position[0, load.link]
        return pose
