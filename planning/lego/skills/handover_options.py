"""Handover options of a step: meeting points and postures of two robots."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planning.cell.workcell import Attachment, PlacedRobot, Workcell
from planning.kinematics.kinematics import inverse_kinematics
from planning.lego.bricks.brick_world import BrickWorld, Placed, goal_name, press_of
from planning.lego.bricks.grips import grip_pose, side_contact_pose
from planning.lego.skills.meeting_points import ReceivePose, giver_rest, receive_poses
from planning.lego.skills.options import SkillOptions
from planning.lego.skills.targets import (
    handover_targets,
    held_box,
    received_top,
)
from planning.skills.contacts import NOTHING, SkillContacts, gripped
from planning.skills.joint_paths import (
    LARGEST_TURN,
    Obstruction,
    SkillPath,
    resolve_skill,
)
from planning.skills.surroundings import SkillScene, find_obstruction
from planning.transforms import Array, Transform


@dataclass(frozen=True)
class HandoverOption:
    """A collision-free handover of a brick.

    Attributes:
        place: index into ``receive_poses`` of the two robots.
        pre_receive: receiver's tool drawn back, before and after, shape (n,).
        receive: receiver's configuration while the brick is pressed on, shape (n,).
        rest: where the giver waits before and after, shape (n,).
        give: the giver's skill.
        top: pose in the world of the brick's top face once it has changed hands.
    """

    place: int
    pre_receive: Array
    receive: Array
    rest: Array
    give: SkillPath
    top: Transform


class HandoverOptions:
    """Finds handovers; each is worked out at most once."""

    def __init__(self, world: BrickWorld, skills: SkillOptions) -> None:
        self.world = world
        self._skills = skills
        self._known: dict[tuple[str, str, int, int], HandoverOption | Obstruction] = {}

    def handover(
        self, giver: str, receiver: str, step: int, grasp: int
    ) -> HandoverOption | Obstruction:
        """Return the handover of a step's brick from one robot to another.

        Tried are the places of ``receive_poses`` in order; the first that works is taken.
        """
        key = (giver, receiver, step, grasp)
        if key not in self._known:
            self._known[key] = self._find(*key)
        return self._known[key]

    def _find(
        self, giver: str, receiver: str, step: int, grasp: int
    ) -> HandoverOption | Obstruction:
        cell = self.world.cell
        taker, source = cell.robot(receiver), cell.robot(giver)
        resting = giver_rest(source.base)
        rests = inverse_kinematics(source, resting.frame, resting.pose, source.home)
        if not rests:
            return Obstruction(f"{resting.name} of {giver} is out of reach")
        reason: Obstruction | None = None
        for index, place in enumerate(receive_poses(taker.base, source.base)):
            for ready in _ready(taker, place):
                found = self._at_place(
                    source, taker, step, grasp, place, ready, rests[0]
                )
                if not isinstance(found, Obstruction):
                    give, top = found
                    return HandoverOption(index, *ready, rests[0], give, top)
                reason = reason or found
        return reason or Obstruction(f"receive is out of reach of {receiver}")

    def _at_place(
        self,
        giver: PlacedRobot,
        receiver: PlacedRobot,
        step: int,
        grasp: int,
        place: ReceivePose,
        ready: tuple[Array, Array],
        rest: Array,
    ) -> tuple[SkillPath, Transform] | Obstruction:
        world, press = self.world, press_of(grasp)
        kind = world.kind(world.step(step).brick)
        goal = world.goal_top(step)
        contact = side_contact_pose(goal, kind, press)
        top = received_top(receiver.model.frames, place.receive.pose, goal, contact)
        targets = handover_targets(
            giver.model.frames,
            kind,
            top,
            press,
            twist=world.assembly.twist["handover"],
        )
        given = Attachment(
            giver.name,
            held_box(giver.model.frames, "tool", grip_pose(top, kind, press), top),
        )
        taken = self._skills.held_for_place(receiver.name, step, grasp)
        name = goal_name(step)
        item = world.goal(step)[0]
        around = self._skills.around(step)
        home = self._skills.home
        grip = gripped(giver.name, name)
        clash = self._receiver_clash(
            world.cell, receiver, {**around, name: (item, taken)}, ready, rest, giver
        )
        if clash is not None:
            return clash
        scene = SkillScene(
            world.cell,
            {**around, name: (item, given)},
            {**home, receiver.name: ready[1]},
            SkillContacts(grip, grip | gripped(receiver.name, name), NOTHING),
            (name, taken),
        )
        path = resolve_skill(giver, targets, lambda p: find_obstruction(p, scene))
        return path if isinstance(path, Obstruction) else (path, top)

    def _receiver_clash(
        self,
        cell: Workcell,
        receiver: PlacedRobot,
        objects: dict[str, Placed],
        ready: tuple[Array, Array],
        rest: Array,
        giver: PlacedRobot,
    ) -> Obstruction | None:
        """Return what the receiver touches on its way in, or out with the brick."""
        pre, receive = ready
        name = next(k for k, (_, at) in objects.items() if at.holder == receiver.name)
        coming = SkillPath("receive", receiver.name, np.array([pre]), receive[None])
        empty = {k: v for k, v in objects.items() if k != name}
        standing = {**self._skills.home, giver.name: giver.home}
        grip = gripped(receiver.name, name)
        scene = SkillScene(
            cell, empty, standing, SkillContacts(NOTHING, NOTHING, NOTHING)
        )
        if found := find_obstruction(coming, scene):
            return found
        leaving = SkillPath("receive", receiver.name, np.array([receive]), pre[None])
        standing = {**standing, giver.name: rest}
        scene = SkillScene(cell, objects, standing, SkillContacts(grip, grip, grip))
        return find_obstruction(leaving, scene)


def _ready(robot: PlacedRobot, place: ReceivePose) -> list[tuple[Array, Array]]:
    """Return the receiver's (pre, receive) postures, nearest to HOME first."""
    out = []
    for pre in inverse_kinematics(robot, place.pre.frame, place.pre.pose, robot.home):
        near = inverse_kinematics(
            robot, place.receive.frame, place.receive.pose, pre, restarts=0
        )
        if near and np.abs(near[0] - pre).max() <= LARGEST_TURN:
            out.append((pre, near[0]))
    return out
