"""A robot on its timeline, in pieces of straight joint-space motion."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planning.construction.world.timeline import RobotTimeline
from planning.transforms import Array, Indices, Transform
from scheduling.witness.motion import Motion
from scheduling.witness.parts import ConvexPart
from scheduling.witness.robot import WitnessRobot
from scheduling.witness.sweeps import SweepBounds

PIECE = 0.02
"""Motions are cut until no point gets further than this from the middle [m]."""


class TimedMotion:
    """A robot on its timeline.

    Args:
        robot: its geometry.
        line: its timeline.

    Attributes:
        robot: its geometry.
        end: from then on it stands [s].
    """

    def __init__(self, robot: WitnessRobot, line: RobotTimeline) -> None:
        self.robot = robot
        self._time, self._path = np.array(line.time), np.array(line.path)
        self.end = float(self._time[-1])

    def at(self, times: Array) -> Array:
        """Return the configurations at some times, shape (s, n)."""
        columns = [np.interp(times, self._time, column) for column in self._path.T]
        return np.stack(columns, axis=1)

    def flange(self, t: float) -> Transform:
        """Return the world pose of the flange at a time."""
        return self.robot.flange_pose(self.at(np.array([t]))[0])

    def knots(self, start: float, end: float) -> Array:
        """Return the times of its rows from one time to another, these included, shape (s,) [s]."""
        inside = (self._time > start) & (self._time < end)
        return np.concatenate([[start], self._time[inside], [end]])

    def reach(self, parts: Sequence[ConvexPart], times: Array) -> Array:
        """Return how far any point of parts gets at most from time to time, shape (s - 1,) [m]."""
        weights = np.array([part.weight for part in parts])
        steps = np.abs(np.diff(self.at(times), axis=0))
        return np.asarray((steps @ weights.T).max(axis=1))


class MovingRobot:
    """A robot and what it holds in a span of time, cut at given times.

    Args:
        motion: of the robot.
        parts: of the robot, then of what it holds.
        times: knots of the pieces, shape (s + 1,) [s].

    Attributes:
        motion, parts: see there.
        knots: configurations at these times, shape (s + 1, n).
        frames: poses of base and joints there, shape (s + 1, n + 1, 4, 4).
        motions: of each part.
        sweeps: what each part sweeps in each piece.
    """

    def __init__(
        self, motion: TimedMotion, parts: Sequence[ConvexPart], times: Array
    ) -> None:
        self.motion, self.parts = motion, parts
        self.knots = motion.at(times)
        self.frames = motion.robot.joint_frames_along(self.knots)
        self.motions = [
            Motion(motion.robot, part, self.knots, self.frames[:, part.joint + 1])
            for part in parts
        ]
        low, high = (
            np.stack(side, axis=2)
            for side in zip(
                *(m.extents(self.pieces) for m in self.motions), strict=True
            )
        )
        self.sweeps = SweepBounds((low,), (high,)).with_coarser()

    @property
    def pieces(self) -> Indices:
        """Numbers of all pieces."""
        return np.arange(len(self.knots) - 1)


def piece_times(
    motions: Sequence[tuple[TimedMotion, Sequence[ConvexPart]]],
    start: float,
    end: float,
) -> Array:
    """Return times between which robots move straight and no part gets far, shape (s + 1,) [s].

    Args:
        motions: of robots, each with its parts and what it holds.
        start, end: of the span [s].
    """
    rows = [motion.knots(start, end) for motion, _ in motions]
    times = np.unique(np.concatenate(rows))
    far = np.max([motion.reach(parts, times) for motion, parts in motions], axis=0)
    counts = np.maximum(np.ceil(0.5 * far / PIECE), 1).astype(np.int64).tolist()
    spans = zip(times[:-1].tolist(), times[1:].tolist(), counts, strict=True)
    cut = [np.linspace(a, b, count, endpoint=False) for a, b, count in spans]
    return np.append(np.concatenate(cut), end)
