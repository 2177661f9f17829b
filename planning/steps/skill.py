"""A manipulation skill: tool poses, joint-space path, allowed contacts, and surroundings."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from functools import cached_property
from itertools import pairwise

import numpy as np

from planning.cell import shape
from planning.cell.workcell import (
    Attachment,
    CellObject,
    PlacedRobot,
    Workcell,
    WorldState,
)
from planning.geometry.robot_bodies import entity_name, robot_bodies, with_deviations
from planning.geometry.scene_checker import SceneChecker
from planning.geometry.standing import StandingBoxes, stand_boxes
from planning.geometry.swept import boxes_in_reach, make_swept
from planning.kinematics.kinematics import follow_poses, frame_pose, inverse_kinematics
from planning.motion.sequential import MARGIN
from planning.transforms import Array, Transform

STRIDE = 0.0075
"""Longest straight path between two subgoals [m]: between them a robot moves on a straight line in
joint space, which then strays from the straight line in the world by a fraction of a
millimetre."""

Pairs = frozenset[frozenset[str]]
"""Unordered pairs of entities that may touch."""

NOTHING: Pairs = frozenset()

LARGEST_TURN = 1.2
"""Most that a joint may turn between two subgoals of a skill; more is another arm posture [rad]."""

Placed = tuple[CellObject, Attachment]
"""An object and where it is."""

Objects = Mapping[str, Placed]
"""Objects by name, and where they are."""


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


class Phase(Enum):
    """A part of a skill with constant allowed contacts and object poses."""

    BEFORE = "before"
    UNTIL_CHANGE = "until the object changes hands"
    SINCE_CHANGE = "since the object changed hands"
    AFTER = "after"

    @property
    def in_skill(self) -> bool:
        """Whether it belongs to the skill itself, not to the transits around it."""
        return self in (Phase.UNTIL_CHANGE, Phase.SINCE_CHANGE)


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
    """Depths by which a tool may overlap resting objects in a skill, besides the handled one.

    Attributes:
        grazing: any object [m].
        pressing: objects that the skill is allowed to touch, and those to lean on [m].
        leaning: names of objects that it may lean on, as deep as on those it may touch.
    """

    grazing: float
    pressing: float
    leaning: frozenset[str] = frozenset()


def tool_entity(robot: PlacedRobot) -> str:
    """Return the entity name of a robot's mounted tool in allowed contacts."""
    return str(robot.tool) if robot.tools else entity_name(robot.name, "tool")


def handled_contact(robot: PlacedRobot, item: str) -> Pairs:
    """Return the contact of the mounted tool of a robot with the object that it handles."""
    return contacts_with(tool_entity(robot), [item])


def grip_contact(robot: str, item: str) -> Pairs:
    """Return the contact of a robot's tool with the object that it handles."""
    return contacts_with(entity_name(robot, "tool"), [item])


def contacts_with(one: str, others: Iterable[str]) -> Pairs:
    """Return the contacts of one thing with others."""
    return frozenset(frozenset((one, other)) for other in others)


@dataclass(frozen=True)
class SkillPath:
    """A skill of one robot in joint space.

    Attributes:
        skill: its name.
        robot: the robot.
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
        """The configuration for costs: where the object changes hands."""
        at = len(self.path) if self.change_at is None else self.change_at
        return np.asarray(self.waypoints[at])


@dataclass(frozen=True)
class Obstruction:
    """The reason why a skill is not possible as planned.

    Attributes:
        words: the reason.
        by: name of the blocking object, fixture or robot part, None if that is not the cause.
        phase: where that is so before the skill begins or after it is over, else None.
        moving: entity of the robot, or object in its hand, that meets it; None if that is not the cause.
    """

    words: str
    by: str | None = None
    phase: Phase | None = None
    moving: str | None = None


def skill_postures(
    robot: PlacedRobot, targets: SkillTargets
) -> Iterator[SkillPath | Obstruction]:
    """Yield the skill in every start posture found, nearest to HOME first.

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


def is_possible_in_some_posture(robot: PlacedRobot, targets: SkillTargets) -> bool:
    """Tell whether a skill is possible in some posture, without obstacles."""
    return any(
        isinstance(displacement, SkillPath)
        for displacement in skill_postures(robot, targets)
    )


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


@dataclass(frozen=True)
class SkillScene:
    """The scene of a skill: the surroundings of the robot, and the object that changes hands.

    Attributes:
        cell: robots and fixtures; its objects are not used.
        objects: the objects there, by name, each with where it is; of those at rest only what
            changes hands, where ``standing`` is given.
        configurations: of all robots.
        contacts: allowed contacts.
        handed: the object that changes hands in the skill and where it is then, or None.
        refill: what stands there once the skill is complete, such as the next brick of a
            feeding station, or None.
        standing: the fixtures and all objects at rest but for what changes hands, where they are
            known already.
        tool: how deep the tool may overlap objects at rest within the skill; None for not at
            all, and without a limit for those that it may touch.
    """

    cell: Workcell
    objects: Objects
    configurations: Mapping[str, Array]
    contacts: SkillContacts
    handed: tuple[str, Attachment] | None = None
    refill: Placed | None = None
    standing: StandingBoxes | None = None
    tool: ToolContact | None = None

    def near(self, path: SkillPath) -> StandingBoxes:
        """Return the fixtures and resting objects that a path may come near to.

        Nothing that could touch is left out: what counts are the capsules swept along the
        path by the robot and by all that it ever holds on it. The object that changes hands
        is not among them.
        """
        held = self._held_by(path.robot, after=False)
        if self.handed is not None and self.handed[1].holder == path.robot:
            held.append((self.objects[self.handed[0]][0], self.handed[1]))
        boxes = self._at_rest
        objects = boxes.rows[boxes.fixtures :]
        robot = self.cell.robot(path.robot)
        own = robot_bodies(robot, held)
        if error := self.cell.deviations.get(path.skill):
            own = with_deviations(own, robot, path.waypoints, error)
        return boxes.only(
            boxes_in_reach(
                make_swept(own.hulls),
                np.vstack([path.lead, path.path]),
                boxes.places.pose[objects],
                boxes.places.half[objects],
                boxes.places.bounds[objects],
                self.cell.clearances.robot_object + MARGIN,
            )
        )

    def checker(
        self, path: SkillPath, boxes: StandingBoxes, phase: Phase, allowed: Pairs
    ) -> SceneChecker:
        """Return the collision checker of a robot in a phase of the skill.

        Args:
            path: of the skill; the robot may deviate from it as the cell says, but before and after.
            boxes: what stands around but for what changes hands, see ``near``.
            phase: of the skill.
            allowed: allowed contacts in it.
        """
        robot, error = path.robot, self.cell.deviations.get(path.skill)
        after = phase in (Phase.SINCE_CHANGE, Phase.AFTER)
        more: list[shape.Placed] = []
        in_hand: list[tuple[PlacedRobot, list[shape.Placed]]] = []
        for name, (item, at) in self._not_at_rest(after=after).items():
            if at.holder == robot:
                continue
            if at.holder is None:
                more += item.shape.placed(name, at.pose)
                continue
            holder = self.cell.robot(at.holder)
            pose = frame_pose(holder, self.configurations[at.holder]) @ at.pose
            in_hand.append((holder, item.shape.placed(name, pose)))
        if phase is Phase.AFTER and self.refill is not None:
            item, at = self.refill
            more += item.shape.placed(item.name, at.pose)
        around = boxes.plus(more)
        for holder, pieces in in_hand:
            around = around.plus(pieces, of_robot=holder)
        return SceneChecker(
            self.cell,
            robot,
            WorldState(self.configurations, {}),
            allowed,
            margin=MARGIN,
            surroundings=(self._held_by(robot, after=after), around),
            deviating=(path.waypoints, error) if error and phase.in_skill else None,
        )

    @cached_property
    def _at_rest(self) -> StandingBoxes:
        if self.standing is not None:
            return self.standing
        handed = None if self.handed is None else self.handed[0]
        return stand_boxes(
            self.cell.fixtures,
            [
                piece
                for name, (item, at) in self.objects.items()
                if at.holder is None and name != handed
                for piece in item.shape.placed(name, at.pose)
            ],
        )

    def _not_at_rest(self, *, after: bool) -> dict[str, Placed]:
        """Return the objects that change hands, or are held, before or after the change."""
        out = {k: v for k, v in self.objects.items() if v[1].holder is not None}
        if self.handed is not None:
            name, at = self.handed
            item, start = self.objects[name]
            out[name] = (item, at if after else start)
        return out

    def _held_by(self, robot: str, *, after: bool) -> list[Placed]:
        around = self._not_at_rest(after=after)
        return [placed for placed in around.values() if placed[1].holder == robot]
