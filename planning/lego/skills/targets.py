"""The six manipulation skills as sequences of subgoals (APEX-MR Sec. V, App. C).

Every learned skill is an approach, an attach and a twist. The first subgoal, ``approach``, is
the goal of the transit before the skill; the skill's own reference path is the rest. Distances
and angles are those of the published demonstrations, checked against its shipped joint paths.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from planning.errors import RobotModelError
from planning.lego.bricks.assembly import LAYER_HEIGHT, BrickType, Press
from planning.lego.bricks.grid import box_from_top, brick_height
from planning.lego.bricks.grips import grip_pose
from planning.skills.subgoals import SkillTargets, Subgoal
from planning.transforms import Transform, inverse, rotation, translation

DEFAULT_TWIST: Mapping[str, float] = {
    "pick": np.radians(16.0),
    "place-down": np.radians(16.0),
    "place-up": np.radians(16.0),
    "handover": np.radians(18.0),
}
"""Twist angles [rad]."""

APPROACH_HEIGHT = 0.010
"""Height of the approach of a place-down above the goal, as published [m]."""

HIGH_APPROACH = 0.012
"""The same where bricks stand on all sides: a brick is 9.6 mm high, and must pass over them [m]."""

_LIFT = 0.015
"""Way straight up after a twist [m]."""


def pick_targets(
    frames: Mapping[str, Transform],
    brick: BrickType,
    top: Transform,
    press: Press,
    *,
    twist: float = DEFAULT_TWIST["pick"],
    by_halves: bool = False,
) -> SkillTargets:
    """Return the subgoals of picking a brick up: approach, above, attach, twist, leave.

    Args:
        frames: the robot's tool frames in its flange frame, ``RobotModel.frames``.
        brick: type of the brick.
        top: pose of the centre of its top face in the world.
        press: the grip.
        twist: angle of the twist that loosens it [rad].
        by_halves: whether half way through the twist is a subgoal of its own: joints turning
            evenly lean the tool further over what stands beside the brick.
    """
    grip = grip_pose(top, brick, press)
    # The twist is about the bottom edge of a brick; that of a plate is nearer to the tool.
    nearer = LAYER_HEIGHT - brick_height(brick)
    axis = _via(frames, grip, "tool", "disassemble") @ translation(0.0, 0.0, -nearer)
    half, turned = (
        axis @ rotation("y", angle) @ translation(0.0, 0.0, nearer)
        for angle in (twist / 2, twist)
    )
    between = (Subgoal("half twist", "disassemble", half),) if by_halves else ()
    subgoals = (
        Subgoal("approach", "tool", grip @ translation(-0.005, 0.005, -0.0056)),
        Subgoal("above", "tool", grip @ translation(0.0, 0.0, -0.0028)),
        Subgoal("attach", "tool", grip),
        *between,
        Subgoal("twist", "disassemble", turned),
        Subgoal("leave", "disassemble", _lifted(turned)),
    )
    return SkillTargets("pick", subgoals, change_at=2)


def place_down_targets(
    frames: Mapping[str, Transform],
    brick: BrickType,
    top: Transform,
    press: Press,
    *,
    attack: int = 1,
    height: float = APPROACH_HEIGHT,
    twist: float = DEFAULT_TWIST["place-down"],
) -> SkillTargets:
    """Return the subgoals of a place-down: approach, above, attach, half twist, twist, leave.

    Half way through the twist is a subgoal of its own: joints turning evenly from one end to the
    other would press the tool deeper into the brick on the way than at either end.

    Args:
        frames: the robot's tool frames in its flange frame.
        brick: type of the brick.
        top: goal pose of the centre of its top face in the world.
        press: the grip, the same as in the pick.
        attack: +1 or -1, the side of the tool's y axis that the approach comes from.
        height: of the approach above the goal [m].
        twist: angle of the twist that releases it [rad].
    """
    grip = grip_pose(top, brick, press)
    axis = _via(frames, grip, "tool", "assemble")
    turned = axis @ rotation("y", -twist)
    subgoals = (
        Subgoal(
            "approach", "tool", grip @ translation(-0.005, 0.005 * attack, -height)
        ),
        Subgoal("above", "tool", grip @ translation(0.0, 0.0, -0.005)),
        Subgoal("attach", "tool", grip),
        Subgoal("half twist", "assemble", axis @ rotation("y", -twist / 2)),
        Subgoal("twist", "assemble", turned),
        Subgoal("leave", "assemble", _lifted(turned)),
    )
    return SkillTargets("place-down", subgoals, change_at=2)


def place_up_targets(
    frames: Mapping[str, Transform],
    contact: Transform,
    *,
    attack: int = 1,
    twist: float = DEFAULT_TWIST["place-up"],
) -> SkillTargets:
    """Return the subgoals of a place-up of a brick held from below on the side studs.

    They are pre (20 mm before the approach), approach, below, place, twist, leave; the first
    two are transit goals in turn.

    Args:
        frames: the robot's tool frames in its flange frame.
        contact: goal pose of the frame ``"alt"`` in the world, see ``grips.side_contact_pose``.
        attack: +1 or -1, sign of the sideways offset of the approach.
        twist: angle of the twist that releases it [rad].
    """
    turned = _via(frames, contact, "alt", "alt_assemble") @ rotation("y", twist)
    aside = -0.005 * attack
    subgoals = (
        Subgoal("pre", "alt", contact @ translation(0.0056, aside, -0.025)),
        Subgoal("approach", "alt", contact @ translation(0.0056, aside, -0.005)),
        Subgoal("below", "alt", contact @ translation(0.0028, 0.0, 0.0)),
        Subgoal("place", "alt", contact),
        Subgoal("twist", "alt_assemble", turned),
        Subgoal("leave", "alt_assemble", turned @ translation(_LIFT, 0.0, -_LIFT)),
    )
    return SkillTargets("place-up", subgoals, change_at=3, lead=2)


def handover_targets(
    frames: Mapping[str, Transform],
    brick: BrickType,
    top: Transform,
    press: Press,
    *,
    twist: float = DEFAULT_TWIST["handover"],
) -> SkillTargets:
    """Return the giver's subgoals of a handover: approach, press, twist, leave.

    Args:
        frames: the giver's tool frames in its flange frame.
        brick: type of the brick.
        top: pose of the centre of its top face once it sits on the receiver's side studs, in
            the world; see ``received_top``.
        press: the grip, the same as in the pick.
        twist: angle of the twist that releases it [rad].
    """
    grip = grip_pose(top, brick, press)
    turned = _via(frames, grip, "tool", "handover_assemble")
    # The published twist also draws the tool back by 1 mm, and once more on leaving.
    back = translation(0.0, 0.0, -0.001)
    turned = turned @ rotation("y", -twist) @ back
    subgoals = (
        Subgoal("approach", "tool", grip @ translation(0.0, 0.0, -0.015)),
        Subgoal("press", "tool", grip),
        Subgoal("twist", "handover_assemble", turned),
        Subgoal("leave", "handover_assemble", _lifted(turned @ back)),
    )
    return SkillTargets("handover", subgoals, change_at=1)


def received_top(
    frames: Mapping[str, Transform], tool: Transform, top: Transform, contact: Transform
) -> Transform:
    """Return where the top face of a handed-over brick is while the receiver stands ready.

    Args:
        frames: the receiver's tool frames in its flange frame.
        tool: pose of the receiver's frame ``"tool"`` in the world as it receives.
        top: goal pose of the centre of the brick's top face in the world.
        contact: goal pose of the receiver's frame ``"alt"``, see ``grips.side_contact_pose``.
    """
    return _via(frames, tool, "tool", "alt") @ inverse(contact) @ top


def held_box(
    frames: Mapping[str, Transform],
    frame: str,
    tool: Transform,
    top: Transform,
    brick: BrickType,
) -> Transform:
    """Return the pose of a held brick's box centre in the flange frame of its holder.

    Args:
        frames: the holder's tool frames in its flange frame.
        frame: the tool frame whose pose is given.
        tool: pose of that frame in the world.
        top: pose of the centre of the brick's top face in the world at that moment.
        brick: its type.
    """
    flange = tool @ inverse(_frame(frames, frame))
    return inverse(flange) @ box_from_top(top, brick)


def _frame(frames: Mapping[str, Transform], name: str) -> Transform:
    if name == "flange" and name not in frames:
        return np.eye(4)
    try:
        return frames[name]
    except KeyError:
        raise RobotModelError(
            f"the robot has no tool frame {name!r}, which the LEGO skills need",
            choices=tuple(sorted(frames)),
        ) from None


def _via(
    frames: Mapping[str, Transform], pose: Transform, start: str, end: str
) -> Transform:
    """Return the pose of tool frame ``end`` when ``start`` of the same tool is at ``pose``."""
    return pose @ inverse(_frame(frames, start)) @ _frame(frames, end)


def _lifted(pose: Transform) -> Transform:
    out = pose.copy()
    out[2, 3] += _LIFT
    return out
