"""The motion of a robot as the fine check sees it: sampled poses, and how far anything gets."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planning.construction.world.timeline import RobotTimeline
from planning.transforms import Array, Transform
from scheduling.verification.reference import Part, ReferenceRobot

SAMPLE = 0.005
"""No point of a robot, or of what it carries, moves further between two samples [m]."""


class Motion:
    """A robot on its timeline.

    Args:
        robot: its geometry.
        line: its timeline.

    Attributes:
        robot: its geometry.
        end: from then on it stands [s].
    """

    def __init__(self, robot: ReferenceRobot, line: RobotTimeline) -> None:
        self.robot = robot
        self._time, self._path = np.array(line.time), np.array(line.path)
        self.end = float(self._time[-1])

    def at(self, times: Array) -> Array:
        """Return the configurations at some times, shape (s, n)."""
        columns = [np.interp(times, self._time, column) for column in self._path.T]
        return np.stack(columns, axis=1)

    def frames(self, times: Array) -> Array:
        """Return the world poses of base and joints, shape (s, n + 1, 4, 4)."""
        return self.robot.joint_frames_along(self.at(times))

    def flange(self, t: float) -> Transform:
        """Return the world pose of the flange at a time."""
        return self.robot.flange_pose(self.at(np.array([t]))[0])

    def samples(self, parts: Sequence[Part], start: float, end: float) -> Array:
        """Return times from ``start`` to ``end`` between which no part gets far, shape (s,).

        Args:
            parts: of the robot, and what it carries.
            start, end: the span, both are samples [s].
        """
        inside = (self._time > start) & (self._time < end)
        times = np.concatenate([[start], self._time[inside], [end]])
        far = np.max(np.diff(self.travelled(parts, times), axis=1), axis=0, initial=0.0)
        count = np.maximum(np.ceil(far / SAMPLE - 1e-9), 1).astype(np.int64)
        pieces = [
            np.linspace(a, b, n, endpoint=False)
            for a, b, n in zip(times[:-1], times[1:], count.tolist(), strict=True)
        ]
        return np.unique(np.concatenate([*pieces, [end]]))

    def travelled(self, parts: Sequence[Part], times: Array, above: int = -1) -> Array:
        """Return bounds of the way of any point of parts up to some times, shape (p, s) [m].

        Args:
            parts: of the robot, and what it carries.
            times: rising, shape (s,) [s].
            above: motion is seen from what this joint moves; -1 for the world.
        """
        weights = np.array([part.weight for part in parts])
        weights[:, : above + 1] = 0.0
        steps = np.abs(np.diff(self._path, axis=0))
        ways = np.zeros((len(parts), len(self._time)))
        np.cumsum(weights @ steps.T, axis=1, out=ways[:, 1:])
        return np.array([np.interp(times, self._time, way) for way in ways])


def moved_corners(before: Transform, after: Transform, size: Array) -> float:
    """Return how far the corner of a box that moves most is away [m]."""
    signs = np.array(np.meshgrid([-0.5, 0.5], [-0.5, 0.5], [-0.5, 0.5]))
    corners = signs.reshape(3, -1).T * np.asarray(size)
    gap = corners @ (before - after)[:3, :3].T + (before - after)[:3, 3]
    return float(np.max(np.linalg.norm(gap, axis=1)))
