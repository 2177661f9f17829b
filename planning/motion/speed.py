"""Durations of straight joint-space motions, and the pose nodes along them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from planning.transforms import Array


class SpeedModel(Protocol):
    """Turns joint-space motions into seconds."""

    def duration(self, q_a: Array, q_b: Array) -> float:
        """Return the time of the straight motion from ``q_a`` to ``q_b``, shape (n,) [s]."""
        ...


@dataclass(frozen=True)
class L1Speed:
    """The paper's model: the sum of all joint travels passes at a fixed rate (APEX-MR V).

    Attributes:
        speed: sum of joint travels per second [rad/s].
        velocity: joint speed limits that no joint exceeds, shape (n,), None for none; a motion
            takes as long as the slowest joint needs where that is longer [rad/s or m/s].
    """

    speed: float = 1.0
    velocity: Array | None = None

    def duration(self, q_a: Array, q_b: Array) -> float:
        """Return the L1 joint distance over the speed, or what a limit makes it [s]."""
        travel = np.abs(q_b - q_a)
        seconds = float(np.sum(travel)) / self.speed
        if self.velocity is None:
            return seconds
        return max(seconds, float(np.max(travel / self.velocity)))


@dataclass(frozen=True)
class JointSpeed:
    """Every joint at most at its own limit; the slowest one decides.

    Attributes:
        velocity: joint speed limits, shape (n,) [rad/s or m/s].
    """

    velocity: Array

    def duration(self, q_a: Array, q_b: Array) -> float:
        """Return the time that the slowest joint needs [s]."""
        return float(np.max(np.abs(q_b - q_a) / self.velocity))


def path_duration(path: Array, speed: SpeedModel) -> float:
    """Return the duration of a polyline, shape (w, n) [s]."""
    return sum(speed.duration(a, b) for a, b in zip(path, path[1:], strict=False))


def path_times(path: Array, speed: SpeedModel) -> Array:
    """Return the times at which a polyline, shape (w, n), passes its waypoints, shape (w,) [s]."""
    steps = [speed.duration(a, b) for a, b in zip(path, path[1:], strict=False)]
    return np.concatenate([[0.0], np.cumsum(steps)])


def sample_path(path: Array, speed: SpeedModel, step: float) -> tuple[Array, Array]:
    """Split a polyline into steps of at most ``step`` seconds, keeping its corners.

    Keeping the corners keeps the motion that was checked: a grid laid over them would cut them.

    Args:
        path: polyline, shape (w, n), w >= 1.
        speed: the speed model.
        step: longest step [s].

    Returns:
        Waypoints, shape (k, n), starting with ``path[0]``, and their times from 0, shape (k,).
    """
    waypoints = [path[0]]
    times = [0.0]
    for a, b in zip(path, path[1:], strict=False):
        seconds = speed.duration(a, b)
        if seconds <= 0.0:
            continue
        parts = max(1, int(np.ceil(seconds / step - 1e-9)))
        for k in range(1, parts + 1):
            waypoints.append(b if k == parts else a + (b - a) * (k / parts))
            times.append(times[-1] + seconds / parts)
    return np.array(waypoints), np.array(times)
