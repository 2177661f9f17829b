"""Skills in joint space: inverse kinematics of all subgoals, and whether nothing is in the way."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from itertools import pairwise

import numpy as np

from planning.geometry.kernel import robot_kernel
from planning.geometry.reach import boxes_in_reach
from planning.geometry.scene import SceneChecker
from planning.kinematics import inverse_kinematics
from planning.sequential import MARGIN
from planning.skill_targets import SkillTargets, Subgoal
from planning.transforms import Array
from planning.workcell import (
    Attachment,
    CellObject,
    PlacedRobot,
    Workcell,
    WorldState,
)

LARGEST_TURN = 1.2
"""Most that a joint may turn between two subgoals of a skill; more is another arm posture [rad]."""

Pairs = frozenset[frozenset[str]]
"""Unordered pairs of entities that may touch."""


@dataclass(frozen=True)
class SkillPath:
    """A skill of one robot in joint space.

    Attributes:
        skill: a name from ``task_graph.SKILLS``.
        robot: who does it.
        lead: goals of the transits before it, shape (l, n); the skill starts from the last.
        path: its reference path after the start, shape (w, n).
        change_at: waypoint of ``[lead[-1], *path]`` at which an object changes hands, None if
            none does.
        support: index of the pre-pose for supports, 0 otherwise.
    """

    skill: str
    robot: str
    lead: Array
    path: Array
    change_at: int | None = None
    support: int = 0

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
class SkillContacts:
    """Who may touch whom around a skill.

    Attributes:
        before: in the transits before it.
        during: in the skill.
        after: in the transit after it.
    """

    before: Pairs
    during: Pairs
    after: Pairs

    def in_phase(self, phase: Phase) -> Pairs:
        """Return who may touch whom in a phase."""
        if phase is Phase.BEFORE:
            return self.before
        return self.after if phase is Phase.AFTER else self.during


@dataclass(frozen=True)
class Obstruction:
    """Why a skill cannot be done as it is.

    Attributes:
        words: the reason.
        by: name of the object, fixture or robot part in the way, None if that is not the cause.
    """

    words: str
    by: str | None = None


class Phase(Enum):
    """A part of a skill in which who may touch whom, and where things are, stays the same."""

    BEFORE = "before"
    UNTIL_CHANGE = "until the object changes hands"
    SINCE_CHANGE = "since the object changed hands"
    AFTER = "after"


@dataclass(frozen=True)
class SkillScene:
    """What stands around a robot while it does a skill.

    Attributes:
        cell: robots and fixtures; its objects are not used.
        objects: the objects there, by name, each with where it is.
        configurations: of all robots.
        contacts: who may touch whom.
        handed: the object that changes hands in the skill and where it is then, or None.
        refill: what stands there once the skill is complete, such as the next brick of a
            feeding station, or None.
    """

    cell: Workcell
    objects: Mapping[str, tuple[CellObject, Attachment]]
    configurations: Mapping[str, Array]
    contacts: SkillContacts
    handed: tuple[str, Attachment] | None = None
    refill: tuple[CellObject, Attachment] | None = None

    def without(self, name: str) -> SkillScene:
        """Return the scene without one object."""
        kept = {k: v for k, v in self.objects.items() if k != name}
        return replace(self, objects=kept)

    def near(self, path: SkillPath) -> SkillScene:
        """Return the scene with only the objects that anything on a path may come near to.

        Nothing that could touch is left out: what counts are the capsules swept along the
        path by the robot and by all that it ever holds on it.
        """
        robot = self.cell.robot(path.robot)
        held = [(i, at) for i, at in self.objects.values() if at.holder == robot.name]
        if self.handed is not None and self.handed[1].holder == robot.name:
            held.append((self.objects[self.handed[0]][0], self.handed[1]))
        names = [k for k, (_, at) in self.objects.items() if at.holder is None]
        close = boxes_in_reach(
            robot_kernel(robot, [(item.body, at.pose) for item, at in held]),
            np.vstack([path.lead, path.path]),
            np.array([self.objects[k][1].pose for k in names]).reshape(-1, 4, 4),
            np.array([self.objects[k][0].size for k in names]).reshape(-1, 3) / 2,
            self.cell.clearances.robot_object + MARGIN,
        )
        keep = {k for k, near in zip(names, close, strict=True) if near}
        keep |= {k for k, (_, at) in self.objects.items() if at.holder is not None}
        if self.handed is not None:
            keep.add(self.handed[0])
        kept = {k: v for k, v in self.objects.items() if k in keep}
        return replace(self, objects=kept)

    def phase_checker(self, robot: str, phase: Phase) -> SceneChecker:
        """Return the collision checker of a robot in a phase of the skill."""
        if phase is Phase.BEFORE:
            return self.checker(robot, self.contacts.before)
        if phase is Phase.UNTIL_CHANGE:
            return self.checker(robot, self.contacts.during)
        if phase is Phase.SINCE_CHANGE:
            return self.checker(robot, self.contacts.during, handed_over=True)
        scene = self
        if self.refill is not None:
            item = self.refill[0]
            scene = replace(self, objects={**self.objects, item.name: self.refill})
        return scene.checker(robot, self.contacts.after, handed_over=True)

    def checker(
        self, robot: str, allowed: Pairs, *, handed_over: bool = False
    ) -> SceneChecker:
        """Return the collision checker of a robot before or after the object changed hands."""
        attachments = {k: at for k, (_, at) in self.objects.items()}
        if handed_over and self.handed is not None:
            attachments[self.handed[0]] = self.handed[1]
        items = tuple(item for item, _ in self.objects.values())
        state = WorldState(self.configurations, attachments)
        return SceneChecker(
            replace(self.cell, objects=items), robot, state, allowed, margin=MARGIN
        )


def find_obstruction(path: SkillPath, scene: SkillScene) -> Obstruction | None:
    """Return what first stands in the way of a skill, None when nothing does.

    Checked are the goals of the transits before it, every stretch of its reference path, and
    its last configuration, from which the next transit starts.
    """
    near = scene.near(path)
    built: dict[bool, SceneChecker] = {}

    def checker_of(phase: Phase) -> SceneChecker:
        """Build one checker while things stay where they are, whatever may touch."""
        if phase is Phase.AFTER and near.refill is not None:
            return near.phase_checker(path.robot, phase)
        handed = phase in (Phase.SINCE_CHANGE, Phase.AFTER) and near.handed is not None
        if handed not in built:
            built[handed] = near.phase_checker(path.robot, phase)
            return built[handed]
        return built[handed].with_allowed(near.contacts.in_phase(phase))

    return check_skill(path, checker_of)


def check_skill(
    path: SkillPath, checker_of: Callable[[Phase], SceneChecker]
) -> Obstruction | None:
    """Return what ``find_obstruction`` does, in a scene that is given by its checkers.

    Args:
        path: of the skill.
        checker_of: returns the collision checker of the robot in a phase of the skill.
    """
    waypoints = path.waypoints
    change = len(waypoints) if path.change_at is None else path.change_at
    checker = checker_of(Phase.BEFORE)
    for q in path.lead:
        if found := _at(checker, q, "before"):
            return found
    checker = checker_of(Phase.UNTIL_CHANGE)
    for k in range(len(waypoints) - 1):
        if k == change:
            checker = checker_of(Phase.SINCE_CHANGE)
        if not checker.motion_free(waypoints[k], waypoints[k + 1]):
            return _on_the_way(checker, waypoints[k], waypoints[k + 1])
    return _at(checker_of(Phase.AFTER), waypoints[-1], "after")


def resolve_skill(
    robot: PlacedRobot,
    targets: SkillTargets,
    check: Callable[[SkillPath], Obstruction | None],
    *,
    support: int = 0,
) -> SkillPath | Obstruction:
    """Return the skill in joint space, in the posture nearest to HOME that is free.

    Args:
        robot: who does it.
        targets: poses to reach in order.
        check: returns what is in the way of a path.
        support: index of the pre-pose, kept in the result.

    Returns:
        The path, or why the posture nearest to HOME that came furthest failed.
    """
    first = targets.subgoals[0]
    postures = _solve(robot, first, robot.home, restarts=40)
    reason: Obstruction | None = None
    for posture in postures:
        chain = _follow(robot, targets.subgoals, posture)
        if isinstance(chain, Obstruction):
            reason = reason or chain
            continue
        path = SkillPath(
            targets.skill,
            robot.name,
            chain[: targets.lead],
            chain[targets.lead :],
            _change_at(targets),
            support,
        )
        found = check(path)
        if found is None:
            return path
        if reason is None or reason.by is None:
            reason = found
    return reason or Obstruction(f"{first.name} is out of reach")


def joint_distance(q_a: Array, q_b: Array) -> float:
    """Return the sum of absolute joint differences, the cost of Appendix B [rad]."""
    return float(np.abs(q_a - q_b).sum())


def _diagonal(item: CellObject) -> float:
    """Return the diagonal of an object's box [m]."""
    return math.sqrt(sum(float(edge) ** 2 for edge in item.size))


def _change_at(targets: SkillTargets) -> int | None:
    at = targets.attach_at if targets.attach_at is not None else targets.detach_at
    return None if at is None else at - targets.lead + 1


def _follow(
    robot: PlacedRobot, subgoals: Sequence[Subgoal], start: Array
) -> Array | Obstruction:
    """Return the configurations of all subgoals in one posture, shape (s, n)."""
    chain = [start]
    for before, subgoal in pairwise(subgoals):
        solutions = _solve(robot, subgoal, chain[-1], restarts=0)
        solutions = solutions or _solve(robot, subgoal, chain[-1], restarts=20)
        if not solutions:
            return Obstruction(f"{subgoal.name} is out of reach")
        if np.abs(solutions[0] - chain[-1]).max() > LARGEST_TURN:
            return Obstruction(
                f"{subgoal.name} needs another posture than {before.name}"
            )
        chain.append(solutions[0])
    return np.array(chain)


def _solve(
    robot: PlacedRobot, subgoal: Subgoal, seed: Array, *, restarts: int
) -> list[Array]:
    return inverse_kinematics(
        robot, subgoal.frame, subgoal.pose, seed, restarts=restarts
    )


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
