"""The six manipulation skills as sequences of subgoals (APEX-MR Sec. V, App. C).

Every learned skill is an approach, an attach and a twist. The first subgoal, ``approach``, is
the goal of the transit before the skill; the skill's own reference path is the rest. Distances
and angles are those of the published demonstrations, checked against its shipped joint paths.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import product

import numpy as np

from planning.errors import RobotModelError
from planning.lego.bricks.assembly import (
    BRICKS,
    LAYER_HEIGHT,
    STUD_PITCH,
    BrickType,
    GridSpan,
    PlacedBrick,
    Plate,
    Press,
    Support,
)
from planning.lego.bricks.grid import (
    box_from_top,
    brick_height,
    grip_pose,
    plate_corner,
    side_contact_pose,
    top_pose,
)
from planning.steps.skill import SkillTargets, Subgoal
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


def place_targets(
    frames: Mapping[str, Transform],
    brick: BrickType,
    top: Transform,
    press: Press,
    *,
    up: bool,
    attack: int = 1,
    height: float = APPROACH_HEIGHT,
    twist: Mapping[str, float] = DEFAULT_TWIST,
) -> SkillTargets:
    """Return the subgoals of a place-down, or of a place-up, of a brick by its grip in the pick.

    See ``place_down_targets``; ``up`` is True for a place-up, whose approach is always as high, and
    ``twist`` has the angles by skill.
    """
    if up:
        contact, turn = side_contact_pose(top, brick, press), twist["place-up"]
        return place_up_targets(frames, contact, attack=attack, twist=turn)
    turn = twist["place-down"]
    return place_down_targets(
        frames, brick, top, press, attack=attack, height=height, twist=turn
    )


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


LEVER_WALL = 0.0032
"""The wall beside the tool's grip stands out this far along the tool [m]."""

STUD_HEIGHT = 0.0017
"""Height of a stud [m]."""

TOP_SHIFT = 0.002
"""The tool of a support-top stands this far inside the edge, along its x [m]."""

BOTTOM_LEAD = 0.001
"""A support-bottom is approached from this far below [m]."""

TOP_LEAD = 0.005
"""A support-top is approached from this far above [m]."""

ORIENTATIONS = (0, 1, 2, 3)

_YAW = (0.0, -np.pi / 2, np.pi / 2, np.pi)
"""Where the tool of each orientation points: towards +x, -y, +y and -x."""

# The 1 x 2 cell behind the supported one, and the side of it that faces back.
_BEHIND = ((1, 0), (0, -1), (0, 1), (-1, 0))
_SIDE = (1, 4, 1, 4)

# Level tool: z along the heading (x for orientation 0), x up.
_LEVEL = np.array(
    [[0.0, 0, 1, 0], [0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 0, 1]], dtype=np.float64
)
# Tool that points down, x along the heading.
_DOWN = np.diag([1.0, -1.0, -1.0, 1.0])


def support_targets(plate: Plate, support: Support) -> tuple[SkillTargets, ...]:
    """Return the poses of a support, along the plate's axes.

    From below, the top of the tool's tip, 16 mm wide, touches the bottom of the bricks in layer
    z + 1. From above, the tool stands on the studs of the bricks in layer z - 1, pointing down.
    (The published code takes the axes of the first robot's base.)

    Args:
        plate: the plate whose grid the support is given in.
        support: its cell and orientation.

    Returns:
        From above, the support from one pre-pose, 5 mm above it. From below, from each of nine
        pre-poses 1 mm lower: straight below first, then shifted by 1 mm.
    """
    frame = plate_corner(plate).copy()
    frame[:3, 3] = 0.0
    heading, z = frame @ rotation("z", _YAW[support.orientation]), support.cell.z
    if support.from_above:
        shift = heading[:3, 0] * TOP_SHIFT
        lift = frame[:3, 2] * (LEVER_WALL + STUD_HEIGHT - LAYER_HEIGHT)
        pose = heading @ _DOWN
        pose[:3, 3] = _contact(plate, support, z)[:3, 3] + shift + lift
        return (_support("support-top", pose, frame, (0.0, 0.0, TOP_LEAD)),)
    up = frame[:3, 2] * (LAYER_HEIGHT - STUD_PITCH)
    pose = heading @ _LEVEL
    pose[:3, 3] = _contact(plate, support, z - 1)[:3, 3] + up
    pose = pose @ translation(0.0, 0.0, -LEVER_WALL)
    return tuple(
        _support(
            "support-bottom",
            pose,
            frame,
            (i * BOTTOM_LEAD, j * BOTTOM_LEAD, -BOTTOM_LEAD),
        )
        for i, j in product((0, 1, -1), repeat=2)
    )


def lever_reaches_below(brick: BrickType) -> bool:
    """Tell whether the wall beside the tool's grip reaches the knobs of what a brick stands on."""
    return brick_height(brick) < LEVER_WALL + STUD_HEIGHT


def supported_span(support: Support) -> GridSpan:
    """Return the room on the grid that the supporting tip takes up, two studs and a brick high."""
    cell = replace(support.cell, turned=support.orientation in (1, 2))
    return PlacedBrick("", BRICKS["1x2"], cell).span


def _contact(plate: Plate, support: Support, layer: int) -> Transform:
    k, at = support.orientation, support.cell
    dx, dy = _BEHIND[k]
    cell = replace(at, x=at.x + dx, y=at.y + dy, z=layer, turned=k in (1, 2))
    pair = PlacedBrick("", BRICKS["1x2"], cell)
    return grip_pose(top_pose(plate, pair), pair.brick, Press(_SIDE[k], 0))


def _support(
    skill: str, pose: Transform, frame: Transform, offset: tuple[float, float, float]
) -> SkillTargets:
    """Return a support that starts at an offset from its pose, given in a frame's axes."""
    pre = pose.copy()
    pre[:3, 3] += frame[:3, :3] @ np.asarray(offset)
    subgoals = (Subgoal("pre", "tool", pre), Subgoal("support", "tool", pose))
    return SkillTargets(skill, subgoals)
