"""Released path of a robot as straight joint-space segments, and the robot's position on it.

Each segment is called a leg. The robot is at rest at both ends of a leg.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from planning.motion.near_path import nearest_points_on_path
from planning.transforms import Array
from twin.drivers.driver import ClearedNode

STRAIGHT = 2e-3
"""Largest deviation of a joint between the path and the leg that replaces it [rad or m]."""

_SAME = 1e-9
"""Joint positions that differ by less are equal [rad or m]."""

_NEAR = 1e-4
"""Distances of a measured configuration that differ by less are equal [rad or m]."""


@dataclass(frozen=True, eq=False)
class PathPoint:
    """A point of a path at which the robot can stop.

    Attributes:
        q: joint positions, shape (n,).
        seconds: planned time of the segment to it [s].
        done: number of nodes that are complete once it is passed.
        stands: whether the robot is there already and stands there for that time.
        act: tool action while it stands; empty for none.
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
    """The points of all nodes for which a robot is cleared so far.

    Args:
        start: joint positions at its start, shape (n,).
        done: number of nodes that are complete there.
    """

    def __init__(self, start: Array, done: int) -> None:
        self.points = [PathPoint(np.array(start), 0.0, done, False, "", -1, 0)]

    def add(self, node: ClearedNode) -> None:
        """Append the points of a node."""
        last = self.points[-1]
        first = last.first if last.task == node.task else node.node
        own = node.task, first
        for k, q in enumerate(node.waypoints):
            took = float(node.seconds[k] - (node.seconds[k - 1] if k else 0.0))
            moves = bool(np.abs(q - self.points[-1].q).max() > _SAME)
            act = node.act if k + 1 == len(node.waypoints) else ""
            if moves:
                self.points.append(PathPoint(q, took, last.done, False, "", *own))
            if act or not moves:
                stay = 0.0 if moves else took
                self.points.append(PathPoint(q, stay, last.done, True, act, *own))
        if self.points[-1] is last:
            self.points.append(PathPoint(last.q, 0.0, last.done, True, "", *own))
        self.points[-1] = replace(self.points[-1], done=node.node + 1)

    def leg_end(self, begin: int, known: int = -1) -> int:
        """Return the last point of the straight leg that begins at a point, which is not the last.

        All points in between lie on it in order, to within ``STRAIGHT``, and the robot stands at none of
        them.

        Args:
            begin: point where it begins.
            known: a point that it is known to reach, -1 for none.
        """
        end = max(begin + 1, known)
        while not self.points[end].stands and end + 1 < len(self.points):
            if self.points[end + 1].stands or not self._is_straight(begin, end + 1):
                break
            end += 1
        return end

    def _is_straight(self, begin: int, end: int) -> bool:
        points = self.configurations(begin, end) - self.points[begin].q
        displacement = points[-1]
        square = float(displacement @ displacement)
        share = points @ displacement / max(square, 1e-18)
        off = np.abs(points - share[:, None] * displacement).max()
        return bool((np.diff(share) >= 0.0).all() and off <= STRAIGHT)

    def configurations(self, begin: int, end: int) -> Array:
        """Return the joint positions from one point to another, both included, shape (k, n)."""
        return np.array([point.q for point in self.points[begin : end + 1]])

    def top_speed(self, begin: int, end: int) -> float:
        """Return the greatest planned joint speed between two points [rad/s or m/s]."""
        displacements = np.abs(np.diff(self.configurations(begin, end), axis=0)).max(
            axis=1
        )
        took = [point.seconds for point in self.points[begin + 1 : end + 1]]
        speeds = [w / t for w, t in zip(displacements, took, strict=True) if t > 0.0]
        return max(speeds, default=np.inf)

    def turn_sine(self, begin: int, corner: int) -> float:
        """Return the sine of the angle between a leg and the next, 1 without one or at a reversal."""
        if corner + 1 >= len(self.points) or self.points[corner + 1].stands:
            return 1.0
        come = self.points[corner].q - self.points[begin].q
        go = self.points[self.leg_end(corner)].q - self.points[corner].q
        lengths = float(np.linalg.norm(come) * np.linalg.norm(go))
        cosine = float(come @ go) / max(lengths, 1e-18)
        return 1.0 if cosine <= 0.0 else float(np.sqrt(max(0.0, 1.0 - cosine**2)))

    def deviation(self, begin: int, end: int, q: Array) -> float:
        """Return the largest joint deviation from the path between two points [rad or m].

        Args:
            begin, end: points of the path.
            q: joint positions, shape (n,).
        """
        return float(
            nearest_points_on_path(self.configurations(begin, end), q[None]).off[0]
        )

    def nearest_segment(self, q: Array) -> tuple[int, float]:
        """Return the start of the path segment nearest to a configuration, and the distance.

        Args:
            q: joint positions, shape (n,).
        """
        off = np.array(
            [self.deviation(k, k + 1, q) for k in range(len(self.points) - 1)]
        )
        first = int(np.flatnonzero(off <= off.min() + _NEAR)[0])
        return first, float(off.min())

    def path_back(self, at: int) -> ClearedPath:
        """Return the path back from a point to the start of its task."""
        task, first = self.points[at].task, self.points[at].first
        back = ClearedPath(self.points[at].q, first + 1)
        k = at
        while k > 0 and self.points[k].task == task:
            point, k = self.points[k], k - 1
            if point.stands:
                continue
            took = point.seconds
            back.points.append(
                PathPoint(self.points[k].q, took, first + 1, False, "", -1, 0)
            )
        return back
