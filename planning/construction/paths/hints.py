"""Hints for path planning: configurations on earlier free paths of the same robot."""

from __future__ import annotations

import numpy as np

from planning.construction.world.fixed_world import FixedWorld
from planning.construction.world.timeline import RobotTimeline
from planning.transforms import Array

_SPACING = 0.75
"""Such places are at most so far apart [s]."""


def retreat_hints(world: FixedWorld, robot: str) -> Array:
    """Return places on a robot's way out of others' way, shape (w, n)."""
    line = world.robots[robot]
    return _places(line, line.busy_until, line.end)


def approach_hints(world: FixedWorld, robot: str) -> Array:
    """Return places on a robot's way to its last skill, which may be a way back, shape (w, n)."""
    line = world.robots[robot]
    since = line.skills[-2][1] if len(line.skills) > 1 else 0.0
    return _places(line, since, line.skills[-1][0])


def _places(line: RobotTimeline, since: float, until: float) -> Array:
    """Return places on a robot's path: waypoints, and some in between, shape (w, n)."""
    corners = line.time[(line.time > since) & (line.time < until)]
    times = np.unique(np.concatenate([corners, np.arange(since, until, _SPACING)]))
    path = [line.at(float(t)) for t in times]
    return np.array(path).reshape(len(times), line.path.shape[1])
