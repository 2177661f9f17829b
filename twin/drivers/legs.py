"""Cleared path of a robot as straight legs from rest to rest, and the robot's position on it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from planning.motion.near_path import nearest_points_on_path
from planning.transforms import Array
from twin.drivers.driver import ClearedNode

STRAIGHT = 2e-3
"""Farthest that a joint of a path may be from the leg that is passed in its place [rad or m]."""

_SAME, _NEAR = 1e-9, 1e-4
"""Joint positions, and distances of measured ones, that differ by less are the same [rad or m]."""


@dataclass(frozen=True, eq=False)
class PathPoint:
    """A point of a path at which the robot can stop.

    Attributes:
        q: joint positions, shape (n,).
        seconds: planned time of the segment to it [s].
        done: nodes that are done once it is passed.
        stands: the robot is there already, and stands there for all of these seconds.
        act: tool action meanwhile; empty for none.
        task: number of the task.
        first: the first node of that task.
    """

    q: Array
    seconds: float
    done: int
    stands: bool
    act: str
    task: int
    first: int


class ClearedPath:
    """The points of all cleared nodes of a robot; grows with clearances.

    Args:
        start: where it begins, shape (n,).
        done: nodes that are done there.
    """

    def __init__(self, start: Array, done: int) -> None:
        self.stops = [PathPoint(np.array(start), 0.0, done, False, "", -1, 0)]

    def add(self, node: ClearedNode) -> None:
        """Append the points of a node."""
        last = self.stops[-1]
        first = last.first if last.task == node.task else node.node
        own = node.task, first
        for k, q in enumerate(node.waypoints):
            took = float(node.seconds[k] - (node.seconds[k - 1] if k else 0.0))
            moves = bool(np.abs(q - self.stops[-1].q).max() > _SAME)
            act = node.act if k + 1 == len(node.waypoints) else ""
            if moves:
                self.stops.append(PathPoint(q, took, last.done, False, "", *own))
            if act or not moves:
                stay = 0.0 if moves else took
                self.stops.append(PathPoint(q, stay, last.done, True, act, *own))
        if self.stops[-1] is last:
            self.stops.append(PathPoint(last.q, 0.0, last.done, True, "", *own))
        self.stops[-1] = replace(self.stops[-1], done=node.node + 1)

    def leg_end(self, begin: int, known: int = -1) -> int:
        """Return the last point of the straight leg that begins at a point, which is not the last.

        All points in between come one after another on it, to within ``STRAIGHT``, and the robot stands
        at none.

        Args:
            begin: point where it begins.
            known: a point up to which it is known to go, -1 for none.
        """
        end = max(begin + 1, known)
        while not self.stops[end].stands and end + 1 < len(self.stops):
            if self.stops[end + 1].stands or not self._is_straight(begin, end + 1):
                break
            end += 1
        return end

    def _is_straight(self, begin: int, end: int) -> bool:
        points = self.points(begin, end) - self.stops[begin].q
        displacement = points[-1]
        square = float(displacement @ displacement)
        share = points @ displacement / max(square, 1e-18)
        off = np.abs(points - share[:, None] * displacement).max()
        return bool((np.diff(share) >= 0.0).all() and off <= STRAIGHT)

    def points(self, begin: int, end: int) -> Array:
        """Return points from one to another, both included, shape (k, n)."""
        return np.array([stop.q for stop in self.stops[begin : end + 1]])

    def top(self, begin: int, end: int) -> float:
        """Return the greatest planned joint speed between two points [rad/s or m/s]."""
        displacements = np.abs(np.diff(self.points(begin, end), axis=0)).max(axis=1)
        took = [stop.seconds for stop in self.stops[begin + 1 : end + 1]]
        speeds = [w / t for w, t in zip(displacements, took, strict=True) if t > 0.0]
        return max(speeds, default=np.inf)

    def turn(self, begin: int, corner: int) -> float:
        """Return the sine of the angle between a leg and the next, 1 without one or at a reversal."""
        if corner + 1 >= len(self.stops) or self.stops[corner + 1].stands:
            return 1.0
        come = self.stops[corner].q - self.stops[begin].q
        go = self.stops[self.leg_end(corner)].q - self.stops[corner].q
        lengths = float(np.linalg.norm(come) * np.linalg.norm(go))
        cosine = float(come @ go) / max(lengths, 1e-18)
        return 1.0 if cosine <= 0.0 else float(np.sqrt(max(0.0, 1.0 - cosine**2)))

    def off(self, begin: int, end: int, q: Array) -> float:
        """Return the largest joint deviation from the path between two points [rad or m].

        Args:
            begin, end: points of the path.
            q: joint positions, shape (n,).
        """
        return float(nearest_points_on_path(self.points(begin, end), q[None]).off[0])

    def nearest(self, q: Array) -> tuple[int, float]:
        """Return the start of the path segment nearest to a configuration, and the distance.

        Args:
            q: joint positions, shape (n,).
        """
        off = np.array([self.off(k, k + 1, q) for k in range(len(self.stops) - 1)])
        first = int(np.flatnonzero(off <= off.min() + _NEAR)[0])
        return first, float(off.min())

    def back(self, at: int) -> ClearedPath:
        """Return the path back from a point to the start of its task."""
        task, first = self.stops[at].task, self.stops[at].first
        back = ClearedPath(self.stops[at].q, first + 1)
        k = at
        while k > 0 and self.stops[k].task == task:
            stop, k = self.stops[k], k - 1
            if stop.stands:
                continue
            took = stop.seconds
            back.stops.append(
                PathPoint(self.stops[k].q, took, first + 1, False, "", -1, 0)
            )
        return back
