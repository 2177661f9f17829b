"""Narrow phase: pairs of shapes that could meet, and adaptive times of measurement.

A pair is skipped as long as contact is excluded: while spheres or boxes around both shapes
are apart, and after each measurement until both together have moved as far as they were apart. Between
two measurements a pair is no nearer than half of what is left of both distances when the motion in
between is taken off. Where that does not exclude contact, or a new least distance of two robots,
it is measured in the middle, and so on until the motion left is ``FINEST``. So every moment is
accounted for, with far fewer measurements than samples.
"""

from __future__ import annotations

import heapq
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import ceil

import numpy as np

from planning.transforms import Array, Indices, Transform
from twin.audits.motion.movers import Track
from twin.audits.motion.reach import RobotSamples
from twin.audits.motion.stretches import RunStretch
from twin.audits.worlds.world import AuditWorld, WatchedShape

REACH = 0.5
"""Gaps are measured up to this (or to the least gap of two robots so far, plus this) [m]."""

FINEST = 1e-4
"""Motion of a pair that is not divided further: gaps are true to within half of it [m]."""


SLACK = 1e-4
"""Overlaps up to this are numerical: 2.5 times the measured error of Bullet's distances [m]."""


@dataclass(frozen=True)
class MeasurementThresholds:
    """Gaps and overlaps that measurements are compared with.

    Attributes:
        least: returns the least gap between robots so far [m].
        depth: returns the overlap that is allowed for two shapes at a sample [m].
    """

    least: Callable[[], float]
    depth: Callable[[WatchedShape, WatchedShape, int], float]

    def meant(self, a: WatchedShape, b: WatchedShape, sample: int) -> bool:
        """Return whether two shapes may touch at a sample."""
        return self.depth(a, b, sample) > SLACK


@dataclass(frozen=True)
class WatchedPair:
    """A pair of shapes, the samples at which it may meet, and how far it has moved up to each.

    Attributes:
        a, b: the shapes.
        close: samples at which they may meet.
        moved: how far they have moved, seen from each other, up to each sample [m].
        between_robots: whether they are of two robots, or of what two robots carry, and are not
            meant to touch.
    """

    a: Track
    b: Track
    close: list[int]
    moved: list[float]
    between_robots: bool

    @property
    def shapes(self) -> tuple[WatchedShape, WatchedShape]:
        """The two shapes."""
        return self.a.shape, self.b.shape

    def next_after(self, sample: int, room: float) -> tuple[int, int | None]:
        """Return when the pair has used up ``room`` [m], and when to measure it next."""
        used = self.moved[sample] + max(room, 0.0)
        until = bisect_right(self.moved, used, sample)
        k = bisect_left(self.close, until)
        return until, self.close[k] if k < len(self.close) else None

    def middle(self, start: float, end: float, used: float) -> float:
        """Return the sample position at which the pair has moved by ``used`` [m]."""
        first, last = int(start), ceil(end)
        k = bisect_right(self.moved, used, first + 1, last) - 1
        share = (used - self.moved[k]) / (self.moved[k + 1] - self.moved[k])
        return k + min(share, 1.0)


@dataclass(frozen=True)
class Gap:
    """The signed distance of two shapes from one sample on until something moves.

    Attributes:
        pair: the shapes.
        sample: at which it was measured, or the last one before.
        until: sample from which on it may be another.
        distance: [m].
        bound: less than this it cannot have been since the measurement before, where that is
            less than asked for; else ``distance`` [m].
    """

    pair: WatchedPair
    sample: int
    until: int
    distance: float
    bound: float


@dataclass(frozen=True)
class _PairDistance:
    """A measurement: sample position, travel of the pair, and its distance [m]."""

    at: float
    moved: float
    distance: float


def measured_gaps(
    world: AuditWorld,
    stretch: RunStretch,
    watched: Sequence[WatchedPair],
    asked: MeasurementThresholds,
) -> Iterator[Gap]:
    """Yield relevant measured gaps, those at samples first, then those in between.

    Every overlap deeper than allowed is among them, and between robots every gap that is less
    than all before it, both to within half of ``FINEST``.

    Args:
        world: its shapes are placed at every sample.
        stretch: the piece of the run.
        watched: pairs of shapes that could meet.
        asked: thresholds to exclude.
    """
    due = [(pair.close[0], k) for k, pair in enumerate(watched)]
    heapq.heapify(due)
    before: list[_PairDistance | None] = [None] * len(watched)
    placer = _Placer(world, stretch)
    between, near = _Between(placer, asked, True), _Between(placer, asked, False)
    while due:
        sample, k = heapq.heappop(due)
        pair, least = watched[k], max(asked.least(), 0.0)
        distance = placer.measure(pair, float(sample), least)
        need = max(min(least, distance), 0.0) if pair.between_robots else 0.0
        until, following = pair.next_after(sample, distance - need)
        if following is not None:
            heapq.heappush(due, (following, k))
        if distance <= 0.0 or (pair.between_robots and distance < asked.least()):
            yield Gap(pair, sample, until, distance, distance)
        now = _PairDistance(float(sample), pair.moved[sample], distance)
        last = before[k]
        if last is not None:
            # When the whole stretch has been measured, few of them are still open.
            (between if pair.between_robots else near).add(pair, last, now)
        # Where the pair is not close in between, its spheres have been apart since.
        before[k] = now if following == until else None
    yield from between.settle()
    yield from near.settle()


class _Between:
    """Queue of intervals between measurements that are still undecided.

    Between robots the worst comes first, which settles the most of what is left; of others the
    earliest, so that what is measured at the same moment is placed once.
    """

    def __init__(
        self, placer: _Placer, asked: MeasurementThresholds, worst_first: bool
    ) -> None:
        self._placer, self._asked, self._worst_first = placer, asked, worst_first
        self._open: list[
            tuple[float, int, float, WatchedPair, _PairDistance, _PairDistance]
        ] = []
        self._count = 0

    def add(self, pair: WatchedPair, low: _PairDistance, high: _PairDistance) -> None:
        """Add two measurements of a pair."""
        bound = 0.5 * (low.distance + high.distance - (high.moved - low.moved))
        if bound >= 0.0 and not pair.between_robots:
            return
        if bound < self._needed(pair, low, high):
            self._count += 1
            first = bound if self._worst_first else 0.5 * (low.at + high.at)
            heapq.heappush(self._open, (first, self._count, bound, pair, low, high))

    def settle(self) -> Iterator[Gap]:
        """Measure in between until all thresholds are decided."""
        while self._open:
            _, _, bound, pair, low, high = heapq.heappop(self._open)
            if bound >= self._needed(pair, low, high):
                continue
            if high.moved - low.moved <= FINEST:
                nearest = min(low.distance, high.distance)
                yield Gap(pair, int(low.at), int(low.at) + 1, nearest, bound)
                continue
            used = 0.5 * (low.moved + high.moved)
            at = pair.middle(low.at, high.at, used)
            distance = self._placer.measure(pair, at, max(self._asked.least(), 0.0))
            if distance <= 0.0 or pair.between_robots:
                yield Gap(pair, int(at), int(at) + 1, distance, distance)
            middle = _PairDistance(at, used, distance)
            self.add(pair, low, middle)
            self.add(pair, middle, high)

    def _needed(
        self, pair: WatchedPair, low: _PairDistance, high: _PairDistance
    ) -> float:
        """Return the distance that must be kept between two measurements [m]."""
        nearest = min(low.distance, high.distance)
        if pair.between_robots:
            least = self._asked.least()
            return least if nearest <= 0.0 else max(least, 0.0)
        if nearest - (high.moved - low.moved) >= 0.0:
            return 0.0
        samples = int(low.at), min(ceil(high.at), len(pair.moved) - 1)
        depth = min(self._asked.depth(*pair.shapes, sample) for sample in samples)
        return -depth if nearest >= -depth else -np.inf


def watched_pairs(
    stretch: RunStretch,
    arms: int,
    exempt: frozenset[tuple[int, int]],
    asked: MeasurementThresholds,
) -> Iterator[WatchedPair]:
    """Yield the pairs that come near each other.

    A pair is close at a sample where it may be nearer than it moves until the sample before or
    the one after: what is not close at two samples is apart all the time between them. In a stretch
        without motion pairs are measured once.

    Args:
        stretch: the piece of the run.
        arms: number of tracks that are of robots; these come first.
        exempt: pairs of one robot's shapes that are not checked, see ``overlapping_at_home``.
        asked: thresholds to exclude.
    """
    movers, boxes = stretch.movers, stretch.boxes
    moving = movers.tracks
    if not moving:
        return
    stands = all(r.distinct[0] == r.distinct[-1] for r in stretch.robots)
    watched = max(asked.least(), 0.0)  # how far apart robots are of interest
    travelled = _summed(movers.steps)
    looked = movers.at_first() if stands else movers
    holders = np.array([track.holder for track in moving])
    first, second = _own_pairs(len(moving), exempt)
    loads = [track.shape.entity for track in moving[arms:]]
    if len(set(loads)) < len(loads):  # shapes of one load may overlap
        whose = np.array([*range(arms), *(arms + loads.index(name) for name in loads)])
        apart = whose[first] != whose[second]
        first, second = first[apart], second[apart]
    between = holders[first] != holders[second]
    room = np.where(between, watched, 0.0)
    for n, close in looked.near_movers(first, second, room):
        i, j = int(first[n]), int(second[n])
        a, b = moving[i], moving[j]
        if between[n]:
            moved = travelled[:, i] + travelled[:, j]
        else:  # as seen from the inner one
            outer = j if a.link <= b.link else i
            moved = _summed(movers.bounds[:, outer, min(a.link, b.link)])
        apart = close
        if between[n] and j >= arms:
            apart = _not_meant(a.shape, b.shape, close, asked)
            if len(apart) < len(close):
                yield WatchedPair(a, b, close, moved.tolist(), False)
        if apart:
            yield WatchedPair(a, b, apart, moved.tolist(), bool(between[n]))
    # A base and a box at rest: nothing moves; bases stand on tables.
    some = [k for k, track in enumerate(moving) if track.link > 0 or k >= arms]
    for i, k, close in looked.near_boxes(np.array(some), boxes):
        alone = travelled[:, i].tolist()
        yield WatchedPair(moving[i], boxes.tracks[k], close, alone, False)


def _not_meant(
    a: WatchedShape, b: WatchedShape, close: list[int], asked: MeasurementThresholds
) -> list[int]:
    """Return the samples at which a contact is not meant, and those at which that begins and ends."""
    free = {k for k in close if not asked.meant(a, b, k)}
    return [k for k in close if free & {k - 1, k, k + 1}]


@lru_cache(maxsize=16)
def _own_pairs(
    count: int, exempt: frozenset[tuple[int, int]]
) -> tuple[Indices, Indices]:
    """Return all pairs of a number of shapes, except unchecked ones."""
    asked = np.ones((count, count), dtype=bool)
    for i, j in exempt:
        asked[i, j] = False
    first, second = np.nonzero(np.triu(asked, 1))
    return first, second


def _summed(steps: Array) -> Array:
    """Return the cumulative travel up to each sample, shape (m, ...) [m]."""
    none = np.zeros((1, *steps.shape[1:]))
    return np.concatenate([none, np.cumsum(steps, axis=0)])


class _Placer:
    """Places shapes at a time, updating only moved ones."""

    def __init__(self, world: AuditWorld, stretch: RunStretch) -> None:
        self.world, self._stretch = world, stretch
        self._arms: list[tuple[int, float] | None] = [None] * len(stretch.robots)
        self._loads: dict[int, tuple[int, float]] = {}

    def measure(self, pair: WatchedPair, at: float, least: float) -> float:
        """Return the distance of a pair at a sample or in between [m].

        Args:
            pair: the pair.
            at: where, in samples.
            least: how far apart robots are of interest [m].
        """
        self.put(pair.a, at)
        self.put(pair.b, at)
        reach = (min(least, 10.0) if pair.between_robots else 0.0) + REACH
        return self.world.distance(*pair.shapes, reach)

    def put(self, track: Track, at: float) -> None:
        """Place a shape as it is at a sample, or between it and the next."""
        if track.holder is None:
            assert track.pose is not None
            self.world.place(track.shape, track.pose)
            return
        k, samples = int(at), self._stretch.robots[track.holder]
        number, share = int(samples.distinct[k]), at - k
        if share > 0.0 and int(samples.distinct[k + 1]) == number:
            share = 0.0
        now = number, share
        if track.pose is not None:
            if self._loads.get(track.shape.number) != now:
                self._loads[track.shape.number] = now
                self.world.place(track.shape, self._pose(track, track.pose, k, share))
        elif self._arms[track.holder] != now:
            self._arms[track.holder] = now
            self.world.configure(track.holder, _between(samples, k, share))

    def _pose(self, load: Track, local: Transform, k: int, share: float) -> Transform:
        """Return the pose of an object in the hand, at a sample or after it."""
        assert load.holder is not None
        samples, hand = self._stretch.robots[load.holder], np.eye(4)
        rotation, position = samples.rotation[k], samples.position[k]
        if share > 0.0:
            q = _between(samples, k, share)
            (rotation,), (position,) = self.world.link_frames(load.holder, q[None])
        hand[:3, :3], hand[:3, 3] = rotation[load.link], position[load.link]
        return np.asarray(hand @ local)


def _between(samples: RobotSamples, k: int, share: float) -> Array:
    """Return the configuration at a sample, or interpolated to the next."""
    q = samples.q[k]
    return q if share <= 0.0 else np.asarray(q + share * (samples.q[k + 1] - q))
