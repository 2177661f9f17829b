"""Skills in joint space: inverse kinematics of all subgoals, and whether nothing is in the way."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from itertools import pairwise

import numpy as np

from planning.geometry.reach import boxes_in_reach
from planning.geometry.robot_bodies import flange_pose, robot_bodies
from planning.geometry.scene import SceneChecker
from planning.geometry.standing import StandingBoxes, stand_boxes
from planning.kinematics import follow_poses, inverse_kinematics
from planning.sequential import MARGIN
from planning.skill_targets import SkillTargets, Subgoal
from planning.transforms import Array
from planning.workcell import Attachment, CellObject, PlacedRobot, Workcell

LARGEST_TURN = 1.2
"""Most that a joint may turn between two subgoals of a skill; more is another arm posture [rad]."""

Pairs = frozenset[frozenset[str]]
"""Unordered pairs of entities that may touch."""

Placed = tuple[CellObject, Attachment]
"""An object and where it is."""


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
    objects: Mapping[str, Placed]
    configurations: Mapping[str, Array]
    contacts: SkillContacts
    handed: tuple[str, Attachment] | None = None
    refill: Placed | None = None

    def near(self, path: SkillPath) -> StandingBoxes:
        """Return the fixtures, and the objects at rest that anything on a path may come near to.

        Nothing that could touch is left out: what counts are the capsules swept along the
        path by the robot and by all that it ever holds on it. The object that changes hands
        is not among them.
        """
        held = self._held_by(path.robot, after=False)
        if self.handed is not None and self.handed[1].holder == path.robot:
            held.append((self.objects[self.handed[0]][0], self.handed[1]))
        boxes = self._at_rest
        objects = boxes.rows[boxes.fixtures :]
        return boxes.only(
            boxes_in_reach(
                robot_bodies(self.cell.robot(path.robot), held).kernel,
                np.vstack([path.lead, path.path]),
                boxes.places.pose[objects],
                boxes.places.half[objects],
                self.cell.clearances.robot_object + MARGIN,
            )
        )

    def checker(self, robot: str, boxes: StandingBoxes, phase: Phase) -> SceneChecker:
        """Return the collision checker of a robot in a phase of the skill.

        Args:
            robot: who does the skill.
            boxes: what stands around but for what changes hands, see ``near``.
            phase: of the skill.
        """
        after = phase in (Phase.SINCE_CHANGE, Phase.AFTER)
        more = []
        for name, (item, at) in self._not_at_rest(after=after).items():
            if at.holder == robot:
                continue
            pose = at.pose
            if at.holder is not None:
                holder = self.cell.robot(at.holder)
                pose = flange_pose(holder, self.configurations[at.holder]) @ pose
            more.append((name, item.body, item.size, pose))
        if phase is Phase.AFTER and self.refill is not None:
            item, at = self.refill
            more.append((item.name, item.body, item.size, at.pose))
        return SceneChecker.amid(
            self.cell,
            robot,
            self._held_by(robot, after=after),
            boxes.plus(more),
            self.configurations,
            self.contacts.in_phase(phase),
            margin=MARGIN,
        )

    @cached_property
    def _at_rest(self) -> StandingBoxes:
        handed = None if self.handed is None else self.handed[0]
        return stand_boxes(
            self.cell,
            [
                (name, item.body, item.size, at.pose)
                for name, (item, at) in self.objects.items()
                if at.holder is None and name != handed
            ],
        )

    def _not_at_rest(self, *, after: bool) -> dict[str, Placed]:
        """Return what changes hands, and what is held, before or after the change."""
        out = {k: v for k, v in self.objects.items() if v[1].holder is not None}
        if self.handed is not None:
            name, at = self.handed
            item, start = self.objects[name]
            out[name] = (item, at if after else start)
        return out

    def _held_by(self, robot: str, *, after: bool) -> list[Placed]:
        around = self._not_at_rest(after=after)
        return [placed for placed in around.values() if placed[1].holder == robot]


class SkillTrial:
    """A path in a scene, checked until something is in the way.

    Attributes:
        path: of the skill.
        found: what is in the way, None when nothing is (any more).
        gone: names of what has been taken away, in this order.
    """

    def __init__(self, path: SkillPath, scene: SkillScene) -> None:
        self.path = path
        self.gone: list[str] = []
        self._scene = scene
        self._near = scene.near(path)
        self._built: dict[bool, SceneChecker] = {}
        self._checkers: dict[Phase, SceneChecker] = {}
        self._obstructions = obstructions(path, self._checker)
        self.found = next(self._obstructions, None)

    def take_away(self, names: Collection[str]) -> Obstruction | None:
        """Go on without whatever is in the way and among some names; return what remains so."""
        while self.found is not None and self.found.by in names:
            assert self.found.by is not None
            if self.found.by in self.gone:
                break
            self.gone.append(self.found.by)
            self._checkers.clear()
            self.found = next(self._obstructions, None)
        return self.found

    def _checker(self, phase: Phase) -> SceneChecker:
        if phase not in self._checkers:
            checker = self._whole(phase)
            if self.gone:
                checker = checker.without(self.gone)
            self._checkers[phase] = checker
        return self._checkers[phase]

    def _whole(self, phase: Phase) -> SceneChecker:
        """Build one checker while things stay where they are, whatever may touch."""
        scene, robot = self._scene, self.path.robot
        if phase is Phase.AFTER and scene.refill is not None:
            return scene.checker(robot, self._near, phase)
        changed = scene.handed is not None
        after = phase in (Phase.SINCE_CHANGE, Phase.AFTER) and changed
        if after not in self._built:
            self._built[after] = scene.checker(robot, self._near, phase)
            return self._built[after]
        return self._built[after].with_allowed(scene.contacts.in_phase(phase))


def find_obstruction(path: SkillPath, scene: SkillScene) -> Obstruction | None:
    """Return what first stands in the way of a skill, None when nothing does.

    Checked are the goals of the transits before it, every stretch of its reference path, and
    its last configuration, from which the next transit starts.
    """
    return SkillTrial(path, scene).found


def check_skill(
    path: SkillPath, checker_of: Callable[[Phase], SceneChecker]
) -> Obstruction | None:
    """Return what ``find_obstruction`` does, in a scene that is given by its checkers.

    Args:
        path: of the skill.
        checker_of: returns the collision checker of the robot in a phase of the skill.
    """
    return next(obstructions(path, checker_of), None)


def obstructions(
    path: SkillPath, checker_of: Callable[[Phase], SceneChecker]
) -> Iterator[Obstruction]:
    """Yield what stands in the way of a skill, from its start to its end.

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
    reason: Obstruction | None = None
    for path in skill_postures(robot, targets, support=support):
        found = path if isinstance(path, Obstruction) else check(path)
        if found is None:
            assert isinstance(path, SkillPath)
            return path
        reason = nearer_reason(reason, found)
    return reason or unreachable(targets)


def skill_postures(
    robot: PlacedRobot, targets: SkillTargets, *, support: int = 0
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
        yield SkillPath(
            targets.skill,
            robot.name,
            chain[: targets.lead],
            chain[targets.lead :],
            _change_at(targets),
            support,
        )


def nearer_reason(known: Obstruction | None, found: Obstruction) -> Obstruction:
    """Return which of two reasons says more: something in the way, in the earlier posture."""
    if known is None or (known.by is None and found.by is not None):
        return found
    return known


def unreachable(targets: SkillTargets) -> Obstruction:
    """Return that there is no posture at all to start in."""
    return Obstruction(f"{targets.subgoals[0].name} is out of reach")


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
