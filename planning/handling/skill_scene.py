"""Scene of a skill: the surroundings of the robot, and collision checkers for each phase of the skill."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from planning.cell.workcell import (
    Attachment,
    CellObject,
    Workcell,
    WorldState,
)
from planning.geometry.robot_bodies import robot_bodies, with_deviations
from planning.geometry.scene_checker import SceneChecker, plus_robots
from planning.geometry.standing import StandingBoxes, stand_boxes
from planning.geometry.swept import boxes_in_reach
from planning.geometry.work_arrays import work_arrays
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
        on the path, may meet. The object that changes hands is not included. What earlier paths of the robot came
        near to is included, so that paths of one place share checkers.
        """
        held = self._held_by(path.robot, after=False)
        if self.handed is not None and self.handed[1].holder == path.robot:
            held.append((self.objects[self.handed[0]][0], self.handed[1]))
        boxes = self._at_rest
        robot = self.cell.robot(path.robot)
        own = robot_bodies(robot, held)
        if error := self.cell.deviations.get(path.skill):
            own = with_deviations(own, robot, path.waypoints, error)
        known = boxes.near_robots.get(path.robot)
        near = np.zeros(len(boxes.rows) - boxes.fixtures, dtype=np.bool_)
        if known is not None:
            near[:] = known[0]
        count = np.count_nonzero(near)
        boxes_in_reach(
            work_arrays(own.hulls).own,
            np.vstack([path.lead, path.path]),
            boxes.pose[boxes.fixtures :],
            boxes.half[boxes.fixtures :],
            boxes.bounds[boxes.fixtures :],
            self.cell.clearances.robot_object + MARGIN,
            near,
        )
        if known is None or np.count_nonzero(near) > count:
            known = boxes.near_robots[path.robot] = near, boxes.only(near)
        return known[1]

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
        robot, after = path.robot, phase in (Phase.SINCE_CHANGE, Phase.AFTER)
        error = self.cell.deviations.get(path.skill) if phase.in_skill else None
        refilled = phase is Phase.AFTER and self.refill is not None
        deviating = path.waypoints.tobytes() if error else b""
        key = robot, after and self.handed is not None, refilled, deviating
        near, checkers = self._checkers.get(key, (None, {}))
        if near is not boxes:
            _, checkers = self._checkers[key] = boxes, {}
        if allowed in checkers:
            return checkers[allowed]
        if checkers:
            made = next(iter(checkers.values())).with_allowed(allowed)
        else:
            others = {
                name: placed
                for name, placed in self._not_at_rest(after=after).items()
                if placed[1].holder != robot
            }
            if refilled:
                assert self.refill is not None
                others[self.refill[0].name] = self.refill
            held, around = (
                self._held_by(robot, after=after),
                self._around(boxes, robot, others),
            )
            made = SceneChecker(
                self.cell,
                robot,
                WorldState(self.configurations, {}),
                allowed,
                margin=MARGIN,
                surroundings=(held, around),
                deviating=(path.waypoints, error) if error else None,
            )
        checkers[allowed] = made
        return made

    def _around(
        self, boxes: StandingBoxes, robot: str, others: Objects
    ) -> StandingBoxes:
        """Return boxes, further objects at rest or held by other robots, and these robots."""
        key = (
            robot,
            *(
                (name, i.shape, at.holder, at.pose.tobytes())
                for name, (i, at) in others.items()
            ),
            *((r, self.configurations[r.name].tobytes()) for r in self.cell.robots),
        )
        if key not in boxes.extended:
            around = boxes.plus(
                [
                    piece
                    for name, (item, at) in others.items()
                    if at.holder is None
                    for piece in item.shape.placed(name, at.pose)
                ]
            )
            for name, (item, at) in others.items():
                if at.holder is not None:
                    holder = self.cell.robot(at.holder)
                    pose = frame_pose(holder, self.configurations[at.holder]) @ at.pose
                    around = around.plus(item.shape.placed(name, pose), of_robot=holder)
            boxes.extended[key] = plus_robots(
                around, self.cell, robot, self.configurations
            )
        return boxes.extended[key]

    @cached_property
    def _checkers(
        self,
    ) -> dict[Hashable, tuple[StandingBoxes, dict[Pairs, SceneChecker]]]:
        """What stands near the latest paths, and checkers by allowed contacts, for each arrangement of objects."""
        return {}

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
