"""Target poses of a skill, and the arm postures in which a robot reaches all of them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from planning.cell.workcell import PlacedRobot
from planning.kinematics.kinematics import follow_poses, inverse_kinematics
from planning.steps.skill import Obstruction, SkillPath
from planning.transforms import Array, Transform

STRIDE = 0.0075
"""Longest straight path between two subgoals [m]. Between them a robot moves on a straight line in joint space,
which then deviates from the straight line in the world by a fraction of a millimetre."""

LARGEST_TURN = 1.2
"""Greatest turn of a joint between two subgoals of a skill; a greater one is a change of the arm posture [rad]."""


@dataclass(frozen=True)
class Subgoal:
    """A target pose of a tool frame.

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
    """Poses that a robot must reach, in order, to execute a skill.

    Attributes:
        skill: its name.
        subgoals: the poses in order.
        change_at: index of the subgoal at which the object changes hands, None if none does: the
            robot takes it, lets go of it, or hands it to the receiver.
        lead: number of first subgoals that are goals of transits; the skill's own reference path is
            ``subgoals[lead:]``.
    """

    skill: str
    subgoals: tuple[Subgoal, ...]
    change_at: int | None = None
    lead: int = 1


def straight_subgoals(
    frame: str, name: str, far: Transform, near: Transform
) -> list[Subgoal]:
    """Return subgoals on the straight path from ``far`` to ``near``, the latter excluded."""
    displacement = near[:3, 3] - far[:3, 3]
    count = max(1, math.ceil(float(np.linalg.norm(displacement)) / STRIDE - 1e-9))
    out = []
    for k in range(count):
        pose = far.copy()
        pose[:3, 3] += displacement * k / count
        out.append(Subgoal(name, frame, pose))
    return out


def skill_postures(
    robot: PlacedRobot, targets: SkillTargets
) -> Iterator[SkillPath | Obstruction]:
    """Yield the skill in every start posture found, nearest to HOME first.

    For a posture in which not all poses can be reached, the reason is yielded instead; likewise if there is none.
    """
    first, lead, at = targets.subgoals[0], targets.lead, targets.change_at
    postures = inverse_kinematics(robot, first.frame, first.pose, robot.home)
    if not postures:
        yield Obstruction(f"{first.name} is out of reach")
    for posture in postures:
        chain = _follow(robot, targets.subgoals, posture)
        if isinstance(chain, Obstruction):
            yield chain
            continue
        # A path counts from its start, the last goal of the transits before it.
        change = None if at is None else at - lead + 1
        yield SkillPath(targets.skill, robot.name, chain[:lead], chain[lead:], change)


def is_possible_in_some_posture(robot: PlacedRobot, targets: SkillTargets) -> bool:
    """Tell whether a skill is possible in some posture, without obstacles."""
    return any(isinstance(path, SkillPath) for path in skill_postures(robot, targets))


def _follow(
    robot: PlacedRobot, subgoals: Sequence[Subgoal], start: Array
) -> Array | Obstruction:
    """Return the configurations of all subgoals in one posture, shape (s, n)."""
    chain = [start]
    found = follow_poses(
        robot,
        [subgoal.frame for subgoal in subgoals],
        [subgoal.pose for subgoal in subgoals],
        start,
    )
    for (before, subgoal), solution in zip(pairwise(subgoals), found, strict=False):
        if solution is None:
            return Obstruction(f"{subgoal.name} is out of reach")
        if np.abs(solution - chain[-1]).max() > LARGEST_TURN:
            return Obstruction(
                f"{subgoal.name} needs another posture than {before.name}"
            )
        chain.append(solution)
    return np.array(chain)
