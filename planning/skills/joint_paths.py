"""Skills in joint space: inverse kinematics of all subgoals, and what stands in the way."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from planning.cell.workcell import PlacedRobot
from planning.geometry.scene_checker import SceneChecker
from planning.kinematics.kinematics import follow_poses, inverse_kinematics
from planning.skills.contacts import Phase
from planning.skills.subgoals import SkillTargets, Subgoal
from planning.transforms import Array

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
    """

    words: str
    by: str | None = None


def obstructions(
    path: SkillPath, checker_of: Callable[[Phase], SceneChecker]
) -> Iterator[Obstruction]:
    """Yield obstructions of a skill, from its start to its end.

    Whoever goes on has taken away what was yielded last: the same place is looked at again, and
    what was clear before it still is.

    Args:
        path: of the skill.
        checker_of: returns the collision checker of the robot in a phase of the skill, at any
            time.
    """
    waypoints = path.waypoints
    change = len(waypoints) if path.change_at is None else path.change_at
    for q in path.lead:
        while found := _at(checker_of(Phase.BEFORE), q, "before"):
            yield found
    phase = Phase.UNTIL_CHANGE
    for k, (q_a, q_b) in enumerate(pairwise(waypoints)):
        if k == change:
            phase = Phase.SINCE_CHANGE
        while not checker_of(phase).motion_free(q_a, q_b):
            yield _on_the_way(checker_of(phase), q_a, q_b)
    while found := _at(checker_of(Phase.AFTER), waypoints[-1], "after"):
        yield found


def skill_postures(
    robot: PlacedRobot, targets: SkillTargets
) -> Iterator[SkillPath | Obstruction]:
    """Yield the skill in every posture found to start in, nearest to HOME first.

    Where a posture does not lead through all poses, why that is.
    """
    first = targets.subgoals[0]
    for posture in inverse_kinematics(robot, first.frame, first.pose, robot.home):
        chain = _follow(robot, targets.subgoals, posture)
        if isinstance(chain, Obstruction):
            yield chain
            continue
        lead, at = targets.lead, targets.change_at
        # A path counts from its start, the last goal of the transits before it.
        change = None if at is None else at - lead + 1
        yield SkillPath(targets.skill, robot.name, chain[:lead], chain[lead:], change)


def unreachable(targets: SkillTargets) -> Obstruction:
    """Return that there is no posture at all to start in."""
    return Obstruction(f"{targets.subgoals[0].name} is out of reach")


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


def _at(checker: SceneChecker, q: Array, when: str) -> Obstruction | None:
    contact = checker.contact(q)
    if contact is None:
        return None
    return Obstruction(f"{contact} {when}", contact.second.split(":")[0])


def _on_the_way(checker: SceneChecker, q_a: Array, q_b: Array) -> Obstruction:
    for t in np.linspace(0.0, 1.0, 9)[::-1]:
        contact = checker.contact(q_a + t * (q_b - q_a))
        if contact is not None:
            return Obstruction(str(contact), contact.second.split(":")[0])
    return Obstruction("something touches between two subgoals")
