"""Runs of straight ways between whose ends corners may be rounded, and how long bends of them are."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from planning.timing.blend import BlendedPath, ordered_windows
from planning.timing.rounded_path import RoundedStretch
from planning.transforms import Array, Indices
from scheduling.graph.temporal_plan_graph import NodeChain
from scheduling.pace import Pace
from scheduling.shortcuts.candidates import Span
from scheduling.stretch_times import node_ends

_APART = 1e-3
"""Zones of corners that are nearer to each other are of one bend [s]."""

_LEAST = 1e-6
"""Ways that take less at full speed have no direction: robots rest at both ends [s]."""

_BESIDE = 1e-6
"""Bends begin and end that far beyond the zones of their corners [s]."""


@dataclass(frozen=True, eq=False)
class Run:
    """Straight ways of a robot, one after another, between whose ends corners may be rounded.

    Attributes:
        chain: index of the robot's chain.
        room: nodes that may be replaced.
        begins: first node of each way, and the node after the last one.
        at: where ways begin and end at full speed, shape (ways + 1,) [s].
        points: the ends of all ways, shape (ways + 1, n).
        way: where nodes begin and end, shape (begins[-1] - begins[0] + 1,) [s].
    """

    chain: int
    room: range
    begins: list[int]
    at: Array
    points: Array
    way: Array

    def windows(self, first: int, last: int, most: Array) -> Array:
        """Return the windows at the corners of some ways, if the robot rests at both ends of them.

        Args:
            first, last: ends of ways.
            most: longest windows at the ends of all ways, shape (ways + 1,) [s].
        """
        begin = self.begins[0]
        low = max(self.at[first], self.way[self.room.start - begin])
        high = min(self.at[last], self.way[self.room.stop - begin])
        own = slice(first + 1, last)
        return ordered_windows(self.at[own], most[own], float(low), float(high))

    def path(self, first: int, last: int, windows: Array) -> BlendedPath:
        """Return the way from an end to another one; it counts from the beginning of the run."""
        own = slice(first, last + 1)
        return BlendedPath(self.at[own], self.points[own], windows)

    def bends(
        self, path: BlendedPath, pace: RoundedStretch
    ) -> Iterator[tuple[float, float]]:
        """Yield where bends begin and end: they include all that limits of corners hold for.

        Args:
            path: from an end of a way to another one.
            pace: at which it is passed.
        """
        begin = self.begins[0]
        floor = max(float(path.at[0]), float(self.way[self.room.start - begin]))
        limit = min(float(path.at[-1]), float(self.way[self.room.stop - begin]))
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
    spans: Sequence[Span],
    number: Indices,
    pace: Pace,
) -> Iterator[Run]:
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
    chain: NodeChain, span: Span, number: Indices, pace: Pace, done: int
) -> Iterator[Run]:
    """Yield the runs of a span.

    Args:
        chain: the chain.
        span: nodes of it that may be replaced.
        number: of the stretch of each node, see ``stretch_numbers``.
        pace: of the robot.
        done: the node after the last run: a way is part of one run at most.
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
    ways = zip(begins, points, np.diff(points, axis=0), strict=False)
    cruise = [pace.full_speed_seconds(*way) for way in ways]
    still = [k for k, seconds in enumerate(cruise) if seconds < _LEAST]
    for before, b in pairwise([-1, *still, len(cruise)]):
        a = before + 1
        if b - a < 2:
            continue
        way = [0.0]
        for k in range(a, b):
            own = np.cumsum(length[begins[k] - low : begins[k + 1] - low])
            way += (way[-1] + cruise[k] * own / own[-1]).tolist()
        nodes = begins[a : b + 1]
        room = range(max(nodes[0], span.first), min(nodes[-1], span.last + 1))
        at = np.array(way)[[node - nodes[0] for node in nodes]]
        yield Run(span.chain, room, nodes, at, points[a : b + 1], np.array(way))
