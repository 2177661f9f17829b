"""Durations of straight joint-space motions, and their division into nodes of a temporal plan graph."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol

import numpy as np

from planning.cell.motion_limits import MotionLimits
from planning.timing.smooth_path import smooth_path
from planning.timing.stretch import straight_seconds
from planning.transforms import Array


class SpeedModel(Protocol):
    """Model of the durations of joint-space motions."""

    def durations(self, travel: Array) -> Array:
        """Return the times of straight motions.

        Args:
            travel: signed displacement of each joint, shape (..., n) [rad or m].

        Returns:
            Shape (...) [s].
        """
        ...

    def duration(self, q_a: Array, q_b: Array) -> float:
        """Return the duration of the straight motion from ``q_a`` to ``q_b``, shape (n,) [s]."""
        return float(self.durations(q_b - q_a))

    def times_along(self, path: Array) -> Array:
        """Return when each waypoint of a skill's path, shape (w, n), is passed, shape (w,) [s]."""
        return path_times(path, self)


@dataclass(frozen=True)
class L1Speed(SpeedModel):
    """The paper's model: the sum of all joint travels passes at a fixed rate (APEX-MR V).

    Attributes:
        speed: sum of joint travels per second [rad/s].
        velocity: joint speed limits that no joint exceeds, shape (n,), None for none; a motion
            takes as long as the slowest joint needs where that is longer [rad/s or m/s].
    """

    speed: float = 1.0
    velocity: Array | None = None

    def durations(self, travel: Array) -> Array:
        """Return the L1 joint distances over the speed, or longer times by joint speed limits [s]."""
        travel = np.abs(travel)
        seconds = np.asarray(np.sum(travel, axis=-1) / self.speed)
        if self.velocity is None:
            return seconds
        return np.asarray(np.maximum(seconds, np.max(travel / self.velocity, axis=-1)))


@dataclass(frozen=True)
class JointSpeed(SpeedModel):
    """Every joint at most at its own limit; the slowest one decides.

    Attributes:
        velocity: joint speed limits, shape (n,) [rad/s or m/s].
    """

    velocity: Array

    def durations(self, travel: Array) -> Array:
        """Return the times that the slowest joint needs [s]."""
        return np.asarray(np.max(np.abs(travel) / self.velocity, axis=-1))


@dataclass(frozen=True)
class LimitedSpeed(SpeedModel):
    """From rest to rest within limits of speed, acceleration and jerk.

    Attributes:
        limits: of the robot.
    """

    limits: MotionLimits

    def durations(self, travel: Array) -> Array:
        """Return the times of straight motions, at rest at both ends [s]."""
        return straight_seconds(self.limits, travel)

    def times_along(self, path: Array) -> Array:
        """Return when each waypoint of a path is passed, shape (w,) [s].

        The robot does not stop at gentle corners.
        """
        return smooth_path(self.limits, path).passed


def path_duration(path: Array, speed: SpeedModel) -> float:
    """Return the duration of a polyline, shape (w, n) [s]."""
    return float(np.sum(speed.durations(np.diff(path, axis=0))))


def path_times(path: Array, speed: SpeedModel) -> Array:
    """Return the times at which a polyline, shape (w, n), passes its waypoints, shape (w,) [s]."""
    steps = speed.durations(np.diff(path, axis=0))
    return np.concatenate([[0.0], np.cumsum(steps)])


def cut_path(
    path: Array, speed: SpeedModel, step: float, count: int | None = None
) -> tuple[Array, Array] | None:
    """Cut a polyline into parts of at most ``step`` seconds, keeping its corners.

    Parts end at every corner, so the motion stays the one that was checked; a uniform grid would cut corners.

    Args:
        path: polyline, shape (w, n), w >= 1.
        speed: the speed model.
        step: longest part [s].
        count: number of parts, by default the smallest possible. Additional parts go to the segments
            with the longest parts.

    Returns:
        The end of each part, shape (k, n), and its duration, shape (k,) [s]; None if ``count`` parts
        are too few.
    """
    legs = [
        (a, b, seconds)
        for a, b in pairwise(path)
        if (seconds := speed.duration(a, b)) > 0.0
    ]
    lasts = np.array([seconds for *_, seconds in legs])
    parts = np.maximum(1, np.ceil(lasts / step - 1e-9)).astype(np.int64)
    if count is not None:
        if len(parts) == 0 or parts.sum() > count:
            return None
        while (spare := count - int(parts.sum())) > 0:
            parts[np.argsort(-lasts / parts, kind="stable")[:spare]] += 1
    ends = [
        b if k == n else a + (b - a) * (k / n)
        for (a, b, _), n in zip(legs, parts.tolist(), strict=True)
        for k in range(1, n + 1)
    ]
    return np.array(ends).reshape(-1, path.shape[1]), np.repeat(lasts / parts, parts)
