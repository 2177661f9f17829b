"""A manipulation skill: the poses of its tool, its path in joint space, and what may touch meanwhile."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import pairwise

import numpy as np

from planning.cell.workcell import PlacedRobot
from planning.geometry.robot_bodies import entity
from planning.kinematics.kinematics import follow_poses, inverse_kinematics
from planning.transforms import Array, Transform

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


Pairs = frozenset[frozenset[str]]
"""Unordered pairs of entities that may touch."""

NOTHING: Pairs = frozenset()


class Phase(Enum):
    """A part of a skill with the same allowed contacts and the same places of all things."""

    BEFORE = "before"
    UNTIL_CHANGE = "until the object changes hands"
    SINCE_CHANGE = "since the object changed hands"
    AFTER = "after"


@dataclass(frozen=True)
class SkillContacts:
    """Allowed contacts before, during and after a skill.

    Attributes:
        before: in the transits before it.
        during: in the skill.
        after: in the transit after it.
    """

    before: Pairs
    during: Pairs
    after: Pairs


@dataclass(frozen=True)
class ToolContact:
    """Depths by which a tool may overlap objects at rest in a skill, besides what it handles.

    Attributes:
        grazing: any object [m].
        pressing: objects that the skill is allowed to touch, and those to lean on [m].
        leaning: names of objects that it may lean on, as deep as on those it may touch.
    """

    grazing: float
    pressing: float
    leaning: frozenset[str] = frozenset()


def tool_entity(robot: PlacedRobot) -> str:
    """Return by which name allowed contacts speak of the tool that a robot has on it."""
    return str(robot.tool) if robot.tools else entity(robot.name, "tool")


def handled(robot: PlacedRobot, item: str) -> Pairs:
    """Return the contact of the tool that a robot has on it with the object that it handles."""
    return touching(tool_entity(robot), [item])


def gripped(robot: str, item: str) -> Pairs:
    """Return the contact of a robot's tool with the object that it handles."""
    return touching(entity(robot, "tool"), [item])


def touching(one: str, others: Iterable[str]) -> Pairs:
    """Return the contacts of one thing with others."""
    return frozenset(frozenset((one, other)) for other in others)


LARGEST_TURN = 1.2
"""Most that a joint may turn between two subgoals of a skill; more is another arm posture [rad]."""


@dataclass(frozen=True)
class SkillPath:
    """A skill of one robot in joint space.

    Attributes:
        skill: its name.
        robot: who does it.
        lead: goals of the transits before it, shape (l, n); the skill starts from the last.
        path: its reference path after the start, shape (w, n).
        change_at: waypoint of ``[lead[-1], *path]`` at which an object changes hands, None if
            none does.
    """

    skill: str
    robot: str
    lead: Array
    path: Array
    change_at: int | None = None

    @property
    def waypoints(self) -> Array:
        """The configuration it starts from and its path, shape (w + 1, n)."""
        return np.vstack([self.lead[-1:], self.path])

    @property
    def contact(self) -> Array:
        """The configuration that costs are measured to: where the object changes hands."""
        at = len(self.path) if self.change_at is None else self.change_at
        return np.asarray(self.waypoints[at])


@dataclass(frozen=True)
class Obstruction:
    """The reason why a skill cannot be done as it is.

    Attributes:
        words: the reason.
        by: name of the object, fixture or robot part in the way, None if that is not the cause.
        phase: where that is so before the skill begins or after it is over, else None.
    """

    words: str
    by: str | None = None
    phase: Phase | None = None


def skill_postures(
    robot: PlacedRobot, targets: SkillTargets
) -> Iterator[SkillPath | Obstruction]:
    """Yield the skill in every posture found to start in, nearest to HOME first.

    Where a posture does not lead through all poses, or there is none at all, why that is.
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


def joint_distance(q_a: Array, q_b: Array) -> float:
    """Return the sum of absolute joint differences, the cost of Appendix B [rad]."""
    return float(np.abs(q_a - q_b).sum())


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
