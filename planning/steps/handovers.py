"""The receiver's side of a handover, whatever is handed over: postures, and what is in their way."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from planning.cell.workcell import PlacedRobot
from planning.kinematics.kinematics import inverse_kinematics
from planning.steps.skill import (
    LARGEST_TURN,
    NOTHING,
    Obstruction,
    SkillContacts,
    SkillPath,
    Subgoal,
)
from planning.steps.skill_scene import SkillScene, find_obstruction
from planning.transforms import Array


def receiver_clash(
    scene: SkillScene,
    receiver: PlacedRobot,
    pre: Array,
    giver: PlacedRobot,
    rest: Array,
) -> Obstruction | None:
    """Return what the receiver of a handover touches on its way in, or out with the object.

    Args:
        scene: with the receiver where it receives and the object in its hand.
        receiver: who takes the object.
        pre: where it comes from and goes to, shape (n,).
        giver: who hands it over.
        rest: where that one stands meanwhile, shape (n,).
    """
    assert scene.handed is not None
    receive = scene.configurations[receiver.name]
    coming = SkillPath("receive", receiver.name, pre[None], receive[None])
    empty = replace(
        scene,
        objects={k: v for k, v in scene.objects.items() if k != scene.handed[0]},
        configurations={**scene.configurations, receiver.name: receiver.home},
        contacts=SkillContacts(NOTHING, NOTHING, NOTHING),
        handed=None,
    )
    if found := find_obstruction(coming, empty):
        return found
    leaving = SkillPath("receive", receiver.name, receive[None], pre[None])
    standing = {**empty.configurations, giver.name: rest}
    return find_obstruction(
        leaving, replace(scene, configurations=standing, handed=None)
    )


def ready_postures(
    robot: PlacedRobot, pre: Subgoal, receive: Subgoal
) -> Iterator[tuple[Array, Array]]:
    """Yield the receiver's (pre, receive) postures, nearest to HOME first."""
    for start in inverse_kinematics(robot, pre.frame, pre.pose, robot.home):
        near = inverse_kinematics(robot, receive.frame, receive.pose, start, restarts=0)
        if near and np.abs(near[0] - start).max() <= LARGEST_TURN:
            yield start, near[0]
