"""Pick and place-down of a box as sequences of subgoals."""

from __future__ import annotations

import math

import numpy as np

from planning.skills.subgoals import SkillTargets, Subgoal
from planning.transforms import Transform, translation

STRIDE = 0.03
"""Longest straight way between two subgoals [m]: between them a robot moves on a straight line in
joint space, which then strays from the straight line in the world by a fraction of a
millimetre."""


def pick_targets(
    frame: str, grip: Transform, approach: float, leave: float
) -> SkillTargets:
    """Return the subgoals of picking a part up: approach, attach, lift.

    Args:
        frame: name of the tool frame.
        grip: pose of that frame in the world where it grips the part.
        approach: length of the straight way along the tool before that [m].
        leave: length of the way straight up after it [m].
    """
    back = grip @ translation(0.0, 0.0, -approach)
    subgoals = [
        *_straight(frame, "approach", back, grip),
        Subgoal("attach", frame, grip),
        *_straight(frame, "lift", _lifted(grip, leave), grip)[::-1],
    ]
    return SkillTargets("pick", tuple(subgoals), change_at=_index(subgoals))


def place_targets(
    frame: str, grip: Transform, approach: float, leave: float
) -> SkillTargets:
    """Return the subgoals of putting a part in place: above, detach, leave.

    Args:
        frame: name of the tool frame.
        grip: pose of that frame in the world where the part is in its place.
        approach: length of the way straight down before that [m].
        leave: length of the straight way back along the tool after it [m].
    """
    back = grip @ translation(0.0, 0.0, -leave)
    subgoals = [
        *_straight(frame, "above", _lifted(grip, approach), grip),
        Subgoal("attach", frame, grip),
        *_straight(frame, "leave", back, grip)[::-1],
    ]
    return SkillTargets("place-down", tuple(subgoals), change_at=_index(subgoals))


def _straight(frame: str, name: str, far: Transform, near: Transform) -> list[Subgoal]:
    """Return subgoals on the straight way from ``far`` to ``near``, the latter left out."""
    way = near[:3, 3] - far[:3, 3]
    count = max(1, math.ceil(float(np.linalg.norm(way)) / STRIDE - 1e-9))
    out = []
    for k in range(count):
        pose = far.copy()
        pose[:3, 3] += way * k / count
        out.append(Subgoal(name, frame, pose))
    return out


def _lifted(pose: Transform, height: float) -> Transform:
    out = pose.copy()
    out[2, 3] += height
    return out


def _index(subgoals: list[Subgoal]) -> int:
    return next(k for k, item in enumerate(subgoals) if item.name == "attach")
