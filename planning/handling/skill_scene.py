"""Scene of a skill: the surroundings of the robot, and collision checkers for each phase of the skill."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from planning.cell import shape
from planning.cell.workcell import (
    Attachment,
    CellObject,
    PlacedRobot,
    Workcell,
    WorldState,
)
from planning.geometry.robot_bodies import robot_bodies, with_deviations
from planning.geometry.scene_checker import SceneChecker
from planning.geometry.standing import StandingBoxes, stand_boxes
from planning.geometry.swept import boxes_in_reach, make_swept
from planning.handling.skill_contacts import SkillContacts, ToolContact
from planning.kinematics.kinematics import frame_pose
from planning.motion.sequential import MARGIN
from planning.steps.skill import Pairs, Phase, SkillPath
from planning.transforms import Array

Placed = tuple[CellObject, Attachment]
"""An object and its place."""

Objects = Mapping[str, Placed]
"""Objects and their places, by name."""


@dataclass(frozen=True)
class SkillScene:
    """The scene of a skill: the surroundings of the robot, and the object that changes hands.

    Attributes:
        cell: robots and fixtures; its objects are not used.
        objects: the objects of the scene with their places, by name. If ``standing`` is given, the only object at
            rest among them is the one that changes hands.
        configurations: of all robots, by name.
        contacts: allowed contacts.
        handed: the object that changes hands in the skill, with its place afterwards, or None.
        refill: object that appears once the skill is complete, such as the next brick of a feeding station, or None.
        standing: the fixtures and all objects at rest except the one that changes hands, if computed before.
        tool: how deep the tool may overlap objects at rest in the skill. None for no overlap, without a limit for
            objects that the tool may touch.
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

        The result is conservative: it includes all that the capsules of the robot, and of every object that it holds
        on the path, may meet. The object that changes hands is not included.
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
