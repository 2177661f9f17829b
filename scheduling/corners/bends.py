"""Rounded corners of transits: paths with corners that may be rounded, and the nodes along each curve.

A transit run is a sequence of straight joint-space segments of one robot, with corners that may be rounded.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from planning.timing.blended_path import BlendedPath, longest_window, ordered_windows
from planning.timing.stretch import RoundedStretch
from planning.transforms import Array, Indices
from scheduling.graph.temporal_plan_graph import NodeChain, RoundedCorners
from scheduling.pace import Pace
from scheduling.shortcuts.candidates import TransitSpan
from scheduling.shortcuts.rewiring import Swap
from scheduling.stretch_times import node_ends

_APART = 1e-3
"""Zones of corners that are nearer to each other are of one bend [s]."""

_LEAST = 1e-6
"""Legs that take less at full speed have no direction: robots rest at both ends [s]."""

_BESIDE = 1e-6
"""Bends begin and end that far beyond the zones of their corners [s]."""

_SAME = 1e-9
"""Legs that differ by less are equal [s]."""

_SHORTEST = 1e-5
"""Least remainder of a node next to a bend [s]."""


@dataclass(frozen=True, eq=False)
class TransitRun:
    """Consecutive straight segments (legs) of a robot path, with corners that may be rounded.

    Attributes:
        pace: of the robot.
        chain: index of its chain.
        room: nodes that may be replaced.
        begins: first node of each leg, and the node after the last one.
        at: ends of the legs at full speed, shape (legs + 1,) [s].
        points: ends of the legs, shape (legs + 1, n).
        times: where nodes begin and end, shape (begins[-1] - begins[0] + 1,) [s].
    """

    pace: Pace
    chain: int
    room: range
    begins: list[int]
    at: Array
    points: Array
    times: Array

    @cached_property
    def longest(self) -> Array:
        """The longest windows at the ends of all legs, shape (legs + 1,) [s]."""
        speed = np.diff(self.points, axis=0) / np.diff(self.at)[:, None]
        longest = np.zeros(len(self.points))
        for k in range(1, len(speed)):
            turn = speed[k] - speed[k - 1]
            longest[k] = longest_window(self.pace.limits, turn)
        return longest

    def windows(self, first: int, last: int, most: Array) -> Array:
        """Return the windows at the corners of some legs, if the robot rests at both ends of them.

        Args:
            first, last: ends of legs.
            most: longest windows at the ends of all legs, shape (legs + 1,) [s].
        """
        begin = self.begins[0]
        low = max(self.at[first], self.times[self.room.start - begin])
        high = min(self.at[last], self.times[self.room.stop - begin])
        own = slice(first + 1, last)
        return ordered_windows(self.at[own], most[own], float(low), float(high))

    def path(self, first: int, last: int, windows: Array) -> BlendedPath:
        """Return the path between two ends of legs; it counts from the beginning of the run."""
        own = slice(first, last + 1)
        return BlendedPath(self.at[own], self.points[own], windows)

    def rounded(
        self, first: int, last: int, windows: Array
    ) -> tuple[BlendedPath, RoundedStretch | None]:
        """Return the path between two ends of legs with its timing, None where it is infeasible."""
        path = self.path(first, last, windows)
        return path, self.pace.rounded(self.begins[first], path)

    def seconds(self, first: int, last: int, windows: Array) -> float:
        """Return the time of some legs without a rest, infinite where that is infeasible."""
        if last - first == 1:
            path = self.points[last] - self.points[first]
            start = self.points[first]
            return self.pace.stretch(self.begins[first], start, path)[0].seconds
        if np.min(windows) <= 0.0:
            return float(np.inf)
        _, found = self.rounded(first, last, windows)
        return float(np.inf) if found is None else found.seconds

    def bends(
        self, path: BlendedPath, pace: RoundedStretch
    ) -> Iterator[tuple[float, float]]:
        """Yield the begin and end of bends, each with all nodes that its corner limits apply to.

        Args:
            path: between two ends of legs.
            pace: at which it is passed.
        """
        begin = self.begins[0]
        floor = max(float(path.at[0]), float(self.times[self.room.start - begin]))
        limit = min(float(path.at[-1]), float(self.times[self.room.stop - begin]))
        order = np.argsort(pace.low)
        low, high = pace.low[order] - _BESIDE, pace.high[order] + _BESIDE
        at, until = float(low[0]), float(high[0])
        for a, b in zip(low.tolist(), high.tolist(), strict=True):
            if a > until + _APART:
                yield max(at, floor), min(until, limit)
                at = a
            until = max(until, b)
        yield max(at, floor), min(until, limit)


def find_runs(
    chain: NodeChain,
    spans: Sequence[TransitSpan],
    number: Indices,
    pace: Pace,
) -> Iterator[TransitRun]:
    """Yield the runs of a chain.

    Args:
        chain: the chain.
        spans: of it, in order.
        number: of the stretch of each node, see ``stretch_numbers``.
        pace: of the robot.
    """
    done = 0
    for span in spans:
        for run in _runs_of(chain, span, number, pace, done):
            yield run
            done = run.begins[-1]


def _runs_of(
    chain: NodeChain, span: TransitSpan, number: Indices, pace: Pace, done: int
) -> Iterator[TransitRun]:
    """Yield the runs of a transit span.

    Args:
        chain: the chain.
        span: nodes of it that may be replaced.
        number: of the stretch of each node, see ``stretch_numbers``.
        pace: of the robot.
        done: the node after the last run: a leg is part of at most one run.
    """
    low = int(np.searchsorted(number, number[span.first]))
    high = int(np.searchsorted(number, number[span.last], side="right"))
    inner = np.flatnonzero(np.diff(number[span.first : span.last + 1])) + 1
    begins = [low, *(span.first + inner).tolist(), high]
    begins = [node for node in begins if node >= done]
    if len(begins) < 3:
        return
    low = begins[0]
    ends = node_ends(chain, low, high)
    length = np.linalg.norm(np.diff(ends, axis=0), axis=1)
    points = ends[[b - low for b in begins]]
    legs = zip(begins, points, np.diff(points, axis=0), strict=False)
    cruise = [pace.full_speed_seconds(*path) for path in legs]
    still = [k for k, seconds in enumerate(cruise) if seconds < _LEAST]
    for before, b in pairwise([-1, *still, len(cruise)]):
        a = before + 1
        if b - a < 2:
            continue
        path = [0.0]
        for k in range(a, b):
            own = np.cumsum(length[begins[k] - low : begins[k + 1] - low])
            path += (path[-1] + cruise[k] * own / own[-1]).tolist()
        nodes = begins[a : b + 1]
        room = range(max(nodes[0], span.first), min(nodes[-1], span.last + 1))
        at = np.array(path)[[node - nodes[0] for node in nodes]]
        yield TransitRun(
            pace, span.chain, room, nodes, at, points[a : b + 1], np.array(path)
        )


class BentNodes(NamedTuple):
    """Nodes along a bend.

    Attributes:
        swap: the nodes that they replace.
        nodes: as many others, as a chain of their own.
        times: where they begin and end, shape (nodes + 1,) [s].
    """

    swap: Swap
    nodes: NodeChain
    times: Array


class NodesLeft:
    """Remaining nodes of a run while its bends are created, one after another.

    Args:
        run: the run.
    """

    def __init__(self, run: TransitRun) -> None:
        self._run, self._start, self._times = run, run.room.start, run.times

    def bent(
        self, chain: NodeChain, path: BlendedPath, low: float, high: float
    ) -> BentNodes | None:
        """Return the nodes of a bend, see ``_bent_nodes``; the remaining nodes are updated."""
        begin, room = self._run.begins[0], range(self._start, self._run.room.stop)
        own = self._times[room.start - begin : room.stop - begin + 1]
        found = _bent_nodes(chain, self._run.chain, room, own, path, low, high)
        if found is not None:
            at = found.swap.first - begin
            self._times = self._times.copy()
            self._times[at : at + len(found.times)] = found.times
            assert found.nodes.corners is not None
            self._start = found.swap.first + int(found.nodes.corners.stop[0])
        return found


def _bent_nodes(
    chain: NodeChain,
    index: int,
    room: range,
    times: Array,
    path: BlendedPath,
    low: float,
    high: float,
) -> BentNodes | None:
    """Return nodes that round some corners by one curve, None where there are too few.

    What is left of the nodes in which it begins and ends comes before and after it.

    Args:
        chain: whose nodes are to be replaced.
        index: of it.
        room: nodes that may be: on the straight paths of ``path``.
        times: where they begin and end, shape (len(room) + 1,) [s].
        path: the whole path.
        low, high: where the bend begins and ends: within no window of a corner [s].
    """
    at = path.at[1:-1]
    corners = (at > low) & (at < high)
    # The last node that begins before the bend, and the first one that ends after it.
    first = int(np.searchsorted(times, low + _SAME, side="right")) - 1
    last = int(np.searchsorted(times, high - _SAME, side="left")) - 1
    if first < 0 or last >= len(room):
        return None
    left = low - float(times[first]), float(times[last + 1]) - high
    if any(_SAME < gap < _SHORTEST for gap in left):
        return None
    before, after = (bool(gap > _SAME) for gap in left)
    own = last - first + 1 - before - after
    if own < 1 and before and first > 0:
        first, own = first - 1, own + 1
    if own < 1 and after and last + 1 < len(room):
        last, own = last + 1, own + 1
    if own < 1:
        return None
    count = max(own, path.chords(low, high))
    points = path.states(low + (high - low) * np.linspace(0.0, 1.0, count + 1))[0]
    marks = np.linspace(0, count, own + 1).round().astype(np.int64)
    counts = np.array([*[1] * before, *np.diff(marks), *[1] * after], dtype=np.int64)
    ends = node_ends(chain, room.start + first, room.start + last + 1)
    waypoints = points if before else points[1:]
    if after:
        waypoints = np.vstack([waypoints, ends[-1:]])
    else:
        waypoints[-1] = ends[-1]
    inner = low + (high - low) * marks / count
    edges = [
        *times[first : first + before],
        *inner,
        *times[last + 1 : last + 1 + after],
    ]
    nodes = slice(room.start + first, room.start + last + 1)
    rank = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    bend = NodeChain(
        chain.robot,
        ends[0],
        waypoints,
        (rank + 1) / np.repeat(counts, counts),
        np.concatenate([[0], np.cumsum(counts)]).astype(np.int64),
        chain.task[nodes],
        np.zeros(len(counts), dtype=np.bool_),
        chain.duration[nodes],
        chain.planned_start[nodes],
        corners=RoundedCorners(
            np.array([int(before)]),
            np.array([int(before) + own]),
            np.array([high - low]),
            np.zeros(int(corners.sum()), dtype=np.int64),
            at[corners] - low,
            path.window[corners],
            path.points[1:-1][corners],
        ),
    )
    swap = Swap(index, nodes.start, nodes.stop - 1)
    return BentNodes(swap, bend, np.array(edges))
