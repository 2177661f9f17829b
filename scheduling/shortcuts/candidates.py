"""Runs of pose nodes that may be shortened, and candidate paths in their place (APEX-MR IV-C).

Consecutive transits are one run, so HOME between them can be skipped. A run ends at a skill,
where the robot's load changes, at a goal that is to be reached for its own sake, and where a
robot waits for, or is waited for by, another one's task: a shortcut must neither skip such a
place nor let anyone pass it too early.

Runs of straight ways between whose ends corners may be rounded, and how long bends of them are.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from planning.motion.speed import SpeedModel, cut_path
from planning.timing.rounded_path import BlendedPath, ordered_windows
from planning.timing.stretch import RoundedStretch
from planning.transforms import Array, Indices
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.graph.temporal_plan_graph import NodeChain
from scheduling.motion_times import node_ends
from scheduling.pace import Pace


@dataclass(frozen=True)
class Span:
    """Pose nodes ``first`` to ``last`` of a chain, both included.

    The node before ``first`` exists: out-edges of skipped nodes move to it.
    """

    chain: int
    first: int
    last: int


def find_spans(graph: DerivedTpg) -> list[Span]:
    """Return the runs of at least two pose nodes, chain by chain, in order."""
    tpg = graph.tpg
    robot_of = {task.index: task.robot for task in tpg.tasks}
    between = [
        (int(a), int(b)) for a, b in tpg.dependencies if robot_of[a] != robot_of[b]
    ]
    goals = {task.index for task in tpg.tasks if task.goal}
    sources = {a for a, _ in between} | goals
    targets = {b for _, b in between}
    out = []
    for index, chain in enumerate(tpg.chains):
        count = len(chain)
        pose = ~chain.skill
        for handling in tpg.handlings:
            if handling.robot == index:
                pose[handling.node] = False
        breaks = np.zeros(count + 1, dtype=np.bool_)
        changes = np.flatnonzero(np.diff(chain.task)) + 1
        for node in changes.tolist():
            before, after = int(chain.task[node - 1]), int(chain.task[node])
            breaks[node] = before in sources or after in targets
            # Its wait must stay in front of all that follows: the node is not replaced.
            pose[node] &= after not in targets
        for span in graph.spans[index]:
            breaks[span.start[0]] = True
            pose[span.start[0] : span.start[0] + 1] = False
        first = 1
        for node in range(1, count + 1):
            if node == count or not pose[node] or breaks[node]:
                if node - first >= 2 and pose[first]:
                    out.append(Span(index, first, node - 1))
                first = node if node < count and pose[node] else node + 1
    return out


LINE, CORNER, JOINT, SMOOTH = "line", "corner", "joint", "smooth"

SHAPES = (LINE, SMOOTH, CORNER, CORNER, JOINT)
"""Shapes of candidates, each as likely as it stands here."""


def candidate_path(old: Array, shape: str, rng: np.random.Generator) -> Array:
    """Return a random polyline with the same ends.

    Args:
        old: waypoints of the way so far, shape (w, n).
        shape: one of SHAPES.
        rng: of corners and joints.
    """
    if shape == LINE:
        return old[[0, -1]]
    if shape == CORNER:
        return _with_corner(old, rng)
    return _straighten(corners(old), int(rng.integers(old.shape[1])))


_STRAIGHT = 1e-9
"""Directions whose components differ by less, the largest being 1, are the same."""


def _with_corner(path: Array, rng: np.random.Generator) -> Array:
    """Return a polyline of the same ends over a corner somewhere between both.

    No joint goes further than on the straight line, so under the L1 speed model it takes no
    longer; but it passes elsewhere.
    """
    share = rng.random(path.shape[1])
    if rng.random() < 0.5:
        share = np.round(share)
    corner = path[0] + share * (path[-1] - path[0])
    return np.array([path[0], corner, path[-1]])


def _straighten(path: Array, joint: int) -> Array:
    """Return a polyline in which one joint goes straight from its first to its last value."""
    out = path.copy()
    travel = np.abs(np.diff(path, axis=0)).sum(axis=1)
    share = np.concatenate([[0.0], np.cumsum(travel)])
    if share[-1] > 0.0:
        out[:, joint] = path[0, joint] + share / share[-1] * (
            path[-1, joint] - path[0, joint]
        )
    return out


def new_nodes(
    chain: NodeChain, first: int, last: int, path: Array, speed: SpeedModel, step: float
) -> NodeChain | None:
    """Return as many nodes for another path, as a chain of their own, None if they do not suffice.

    Each has the task and the planned start of the node that it replaces.

    Args:
        chain: whose nodes ``first`` to ``last`` are to be replaced.
        first, last: those nodes.
        path: polyline of the same ends, shape (w, n).
        speed: speed model of the robot.
        step: longest time between nodes [s].
    """
    count = last - first + 1
    sampled = cut_path(path, speed, step, count)
    if sampled is None:
        return None
    waypoints, duration = sampled
    return NodeChain(
        chain.robot,
        path[0],
        waypoints,
        np.ones(count),
        np.arange(count + 1),
        chain.task[first : last + 1],
        np.zeros(count, dtype=np.bool_),
        duration,
        chain.planned_start[first : last + 1],
    )


def corners(path: Array) -> Array:
    """Return a polyline without the waypoints that lie on the straight way past them."""
    way = np.diff(path, axis=0)
    far = np.abs(way).max(axis=1)
    kept = [0]
    along = None
    for k, (step, size) in enumerate(zip(way, far.tolist(), strict=True)):
        if size == 0.0:
            continue
        direction = step / size
        if along is not None and np.max(np.abs(direction - along)) > _STRAIGHT:
            kept.append(k)
        along = direction
    return path[[*kept, len(path) - 1]]


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
