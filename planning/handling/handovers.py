"""Handovers of an object between two robots in the air, at given meeting places."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from planning.cell.workcell import Attachment, CellObject, PlacedRobot, Workcell
from planning.handling.skill_contacts import NOTHING, SkillContacts, grip_contact
from planning.handling.skill_scene import Objects, SkillScene
from planning.handling.skill_targets import LARGEST_TURN, SkillTargets, Subgoal
from planning.handling.skill_trial import find_obstruction, resolve_skill
from planning.kinematics.kinematics import inverse_kinematics
from planning.steps.skill import Obstruction, SkillPath
from planning.transforms import Array, Transform


@dataclass(frozen=True)
class MeetingPlace:
    """A place in the air where one robot may hand an object over to another.

    Attributes:
        giver: the robot that brings the object.
        receiver: the robot that takes it.
        item: what is handed over.
        given: how the giver holds it.
        taken: the receiver's hold after the handover.
        at: pose of the object in the world as it changes hands.
        pre: where the tool of the receiver comes from, and goes to with the object.
        receive: where that tool is meanwhile.
        targets: what the giver does.
        rest: where the giver stands before and after, shape (n,).
    """

    giver: PlacedRobot
    receiver: PlacedRobot
    item: CellObject
    given: Attachment
    taken: Attachment
    at: Transform
    pre: Subgoal
    receive: Subgoal
    targets: SkillTargets
    rest: Array


@dataclass(frozen=True)
class Handover:
    """A collision-free handover.

    Attributes:
        meeting: where the two robots meet.
        pre: where the receiver comes from and goes to with the object, shape (n,).
        receive: where it stands while it is given the object, shape (n,).
        give: the giver's skill.
    """

    meeting: MeetingPlace
    pre: Array
    receive: Array
    give: SkillPath


def find_handover(
    cell: Workcell, around: Objects, meeting: MeetingPlace
) -> Handover | Obstruction | None:
    """Return the handover at a meeting, in the receiver's first free posture.

    Args:
        cell: all robots but the two stand at HOME.
        around: all other objects.
        meeting: of the two.

    Returns:
        The obstruction of the first posture where none is free; None where the receiver has no
        posture at all.
    """
    giver, receiver, item = meeting.giver, meeting.receiver, meeting.item
    home = {robot.name: robot.home for robot in cell.robots}
    giving, taking = (
        grip_contact(giver.name, item.name),
        grip_contact(receiver.name, item.name),
    )
    reason: Obstruction | None = None
    for pre, receive in _ready_postures(receiver, meeting.pre, meeting.receive):
        scene = SkillScene(
            cell,
            {**around, item.name: (item, meeting.taken)},
            {**home, receiver.name: receive},
            SkillContacts(taking, taking, taking),
            (item.name, meeting.taken),
        )
        if clash := _receiver_clash(scene, meeting, pre):
            reason = reason or clash
            continue
        scene = replace(
            scene,
            objects={**around, item.name: (item, meeting.given)},
            contacts=SkillContacts(giving, giving | taking, NOTHING),
        )
        found = resolve_skill(giver, [meeting.targets], scene)
        if not isinstance(found, Obstruction):
            return Handover(meeting, pre, receive, found.path)
        reason = reason or found
    return reason


def _receiver_clash(
    scene: SkillScene, meeting: MeetingPlace, pre: Array
) -> Obstruction | None:
    """Return the obstacle of the receiver on its approach, or on its retreat with the object.

    Args:
        scene: with the receiver where it receives and the object in its hand.
        meeting: of the two robots.
        pre: where the receiver comes from and goes to, shape (n,).
    """
    name, giver = meeting.receiver.name, meeting.giver.name
    receive = scene.configurations[name]
    coming = SkillPath("receive", name, pre[None], receive[None])
    empty = replace(
        scene,
        objects={k: v for k, v in scene.objects.items() if k != meeting.item.name},
        configurations={**scene.configurations, name: meeting.receiver.home},
        contacts=SkillContacts(NOTHING, NOTHING, NOTHING),
        handed=None,
    )
    if found := find_obstruction(coming, empty):
        return found
    leaving = SkillPath("receive", name, receive[None], pre[None])
    standing = {**empty.configurations, giver: meeting.rest}
    return find_obstruction(
        leaving, replace(scene, configurations=standing, handed=None)
    )


def _ready_postures(
    robot: PlacedRobot, pre: Subgoal, receive: Subgoal
) -> Iterator[tuple[Array, Array]]:
    """Yield the receiver's (pre, receive) postures, nearest to HOME first."""
    for start in inverse_kinematics(robot, pre.frame, pre.pose, robot.home):
        near = inverse_kinematics(robot, receive.frame, receive.pose, start, restarts=0)
        if near and np.abs(near[0] - start).max() <= LARGEST_TURN:
            yield start, near[0]
