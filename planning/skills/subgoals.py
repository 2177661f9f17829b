"""A manipulation skill as the poses that a robot's tool comes to, in order."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from planning.transforms import Transform

STRIDE = 0.0075
"""Longest straight way between two subgoals [m]: between them a robot moves on a straight line in
joint space, which then strays from the straight line in the world by a fraction of a
millimetre."""


@dataclass(frozen=True)
class Subgoal:
    """A pose that a tool frame must reach.

    Attributes:
        name: "approach", "attach", "twist", "leave" and the like.
        frame: name of the tool frame, a key of RobotModel.frames.
        pose: of that frame in the world.
    """

    name: str
    frame: str
    pose: Transform


@dataclass(frozen=True)
class SkillTargets:
    """One execution of a skill as poses to reach, in order.

    Attributes:
        skill: its name.
        subgoals: poses in order; the robot comes to each in turn.
        change_at: index of the subgoal at which the object changes hands, None if none does: the
            robot takes it, lets go of it, or hands it to the receiver.
        lead: how many subgoals at the front are goals of transits; the skill's own reference
            path is ``subgoals[lead:]``.
    """

    skill: str
    subgoals: tuple[Subgoal, ...]
    change_at: int | None = None
    lead: int = 1


def straight_way(
    frame: str, name: str, far: Transform, near: Transform
) -> list[Subgoal]:
    """Return subgoals on the straight way from ``far`` to ``near``, the latter left out."""
    way = near[:3, 3] - far[:3, 3]
    count = max(1, math.ceil(float(np.linalg.norm(way)) / STRIDE - 1e-9))
    out = []
    for k in range(count):
        pose = far.copy()
        pose[:3, 3] += way * k / count
        out.append(Subgoal(name, frame, pose))
    return out
