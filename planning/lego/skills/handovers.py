"""Handovers of a brick between two robots: where they meet, and in which postures.

The receiver holds its tool level towards the giver, side studs up; the giver comes down from
above. The published place is tried first, then others around it in the vertical plane between
the two bases, nearest to it first.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from planning.cell.workcell import Attachment, PlacedRobot
from planning.kinematics.kinematics import inverse_kinematics
from planning.lego.bricks.brick_world import goal_name, press_of
from planning.lego.bricks.grips import grip_pose, side_contact_pose
from planning.lego.skills.options import SkillOptions
from planning.lego.skills.targets import handover_targets, held_box, received_top
from planning.steps.handovers import ready_postures, receiver_clash
from planning.steps.skill import (
    NOTHING,
    Obstruction,
    SkillContacts,
    SkillPath,
    Subgoal,
    gripped,
)
from planning.steps.skill_scene import SkillScene, resolve_skill
from planning.transforms import Array, Transform, rotation, translation

REACH = 0.45
"""Distance of the receiving tool from the receiver's base axis [m]."""

HEIGHT = 0.35
"""Height of the receiving tool above the receiver's base [m]."""

DRAW_BACK = 0.075
"""The receiver waits and comes away this far behind the place of the handover [m]."""

REST = (0.2, 0.0, 0.5)
"""Where the giver's flange waits before and after, pointing down, in its base frame [m]."""

_REACHES = (0.40, 0.45, 0.50, 0.35)
"""Distances of a handover from the base of the robot that receives [m]."""

_HEIGHTS = (0.35, 0.40, 0.30, 0.45, 0.25)
"""Heights of a handover above that base, tried in this order [m]."""

_FACING = np.radians(10.0)

# Tool z along the base's x, tool x down: the side studs of the tool look up.
_LEVEL = rotation("y", np.pi / 2)


def receive_poses(
    receiver: Transform, giver: Transform
) -> tuple[tuple[Subgoal, Subgoal], ...]:
    """Return places to receive a brick, in the order in which they should be tried.

    Args:
        receiver: base pose of the receiving robot in the world.
        giver: base pose of the giving robot in the world.

    Returns:
        Candidates (pre, receive), the same list for the same bases: the tool drawn back, where
        it comes from and goes to with the brick, and held still while the brick is pressed onto
        its side studs. The first is the published one, 0.45 m in front of the receiver's base
        and 0.35 m up, towards the giver. Where the base's x axis points to the giver within 10
        degrees, it gives the direction, as published; the exact bearing follows.
    """
    bearing = _bearing(receiver, giver)
    directions = [bearing]
    if abs(bearing) < _FACING:
        directions = [0.0] if abs(bearing) < 1e-9 else [0.0, bearing]
    half = 0.5 * float(np.linalg.norm((giver - receiver)[:2, 3]))
    reaches = sorted({*_REACHES, round(half, 3)}, key=lambda r: (abs(r - REACH), r))
    places = sorted(
        product(reaches, _HEIGHTS, directions),
        key=lambda p: (
            round(abs(p[0] - REACH) + abs(p[1] - HEIGHT), 6),
            reaches.index(p[0]),
            _HEIGHTS.index(p[1]),
            directions.index(p[2]),
        ),
    )
    return tuple(_candidate(receiver, *place) for place in places)


def giver_rest(giver: Transform) -> Subgoal:
    """Return the giver's pose before and after a handover: flange pointing down.

    Args:
        giver: base pose of the giving robot in the world.
    """
    pose = giver @ translation(*REST) @ rotation("x", np.pi)
    return Subgoal("handover rest", "flange", pose)


def _candidate(
    receiver: Transform, reach: float, height: float, bearing: float
) -> tuple[Subgoal, Subgoal]:
    tool = receiver @ rotation("z", bearing) @ translation(reach, 0.0, height) @ _LEVEL
    pre = Subgoal("pre-receive", "tool", tool @ translation(0.0, 0.0, -DRAW_BACK))
    return pre, Subgoal("receive", "tool", tool)


def _bearing(receiver: Transform, giver: Transform) -> float:
    """Return the direction of ``giver`` about ``receiver``'s z axis, from its x axis [rad]."""
    away = receiver[:3, :3].T @ (giver[:3, 3] - receiver[:3, 3])
    return float(np.arctan2(away[1], away[0]))


@dataclass(frozen=True)
class HandoverOption:
    """A collision-free handover of a brick.

    Attributes:
        pre_receive: receiver's tool drawn back, before and after, shape (n,).
        receive: receiver's configuration while the brick is pressed on, shape (n,).
        rest: where the giver waits before and after, shape (n,).
        give: the giver's skill.
        top: pose in the world of the brick's top face once it has changed hands.
    """

    pre_receive: Array
    receive: Array
    rest: Array
    give: SkillPath
    top: Transform


class HandoverOptions:
    """Finds handovers; each is worked out at most once."""

    def __init__(self, skills: SkillOptions) -> None:
        self._skills = skills
        self._found: dict[tuple[str, str, int, int], HandoverOption | Obstruction] = {}

    def handover(
        self, giver: str, receiver: str, step: int, grasp: int
    ) -> HandoverOption | Obstruction:
        """Return how a brick goes from one robot to another, at the first place that works.

        Args:
            giver, receiver: names of the robots.
            step: of the brick, counted from 1.
            grasp: number of the grip.
        """
        key = giver, receiver, step, grasp
        if key not in self._found:
            self._found[key] = self._find(*key)
        return self._found[key]

    def exchanged(self, skills: SkillOptions, step: int) -> HandoverOptions:
        """Return the handovers where a step and the next one are exchanged.

        Known ones of other steps are not worked out again.
        """
        other = HandoverOptions(skills)
        for key, found in self._found.items():
            if key[2] not in (step, step + 1):
                other._found[key] = found
        return other

    def _find(
        self, giver: str, receiver: str, step: int, grasp: int
    ) -> HandoverOption | Obstruction:
        cell = self._skills.world.cell
        taker, source = cell.robot(receiver), cell.robot(giver)
        resting = giver_rest(source.base)
        rests = inverse_kinematics(source, resting.frame, resting.pose, source.home)
        if not rests:
            return Obstruction(f"{resting.name} of {giver} is out of reach")
        reason: Obstruction | None = None
        for place in receive_poses(taker.base, source.base):
            for pre, receive in ready_postures(taker, *place):
                scene = self._scene(receiver, step, grasp, receive)
                found = receiver_clash(scene, taker, pre, source, rests[0]) or (
                    self._give(scene, source, place[1].pose, step, grasp)
                )
                if not isinstance(found, Obstruction):
                    give, top = found
                    return HandoverOption(pre, receive, rests[0], give, top)
                reason = reason or found
        return reason or Obstruction(f"receive is out of reach of {receiver}")

    def _scene(
        self, receiver: str, step: int, grasp: int, receive: Array
    ) -> SkillScene:
        """Return the scene in which the receiver stands with the brick that it was given."""
        skills, name = self._skills, goal_name(step)
        taken = skills.held_for_place(receiver, step, grasp)
        brick = (skills.world.goal(step)[0], taken)
        grip = gripped(receiver, name)
        return SkillScene(
            skills.world.cell,
            {**skills.around(step), name: brick},
            {**skills.home, receiver: receive},
            SkillContacts(grip, grip, grip),
            (name, taken),
        )

    def _give(
        self,
        scene: SkillScene,
        giver: PlacedRobot,
        tool: Transform,
        step: int,
        grasp: int,
    ) -> tuple[SkillPath, Transform] | Obstruction:
        """Return the giver's skill and the pose of the brick's top face after it.

        The scene is that of the receiver, whose tool is at a pose in the world.
        """
        world, press = self._skills.world, press_of(grasp)
        kind, goal = world.step(step).brick, world.goal_top(step)
        assert scene.handed is not None
        name, taken = scene.handed
        assert taken.holder is not None
        contact = side_contact_pose(goal, kind, press)
        top = received_top(world.frames(taken.holder), tool, goal, contact)
        frames, twist = giver.model.frames, world.assembly.twist["handover"]
        held = held_box(frames, "tool", grip_pose(top, kind, press), top, kind)
        given = (scene.objects[name][0], Attachment(giver.name, held))
        grip = gripped(giver.name, name)
        scene = replace(
            scene,
            objects={**scene.objects, name: given},
            contacts=SkillContacts(grip, grip | scene.contacts.during, NOTHING),
        )
        targets = handover_targets(frames, kind, top, press, twist=twist)
        found = resolve_skill(giver, targets, scene)
        return found if isinstance(found, Obstruction) else (found.path, top)
