"""Picks, places and handovers of bricks as sequences of subgoals (APEX-MR Sec. V, App. C).

Every skill of APEX-MR consists of an approach, an attachment and a twist. The first subgoal, ``approach``, is
the goal of the transit before the skill; the other subgoals define the reference path of the skill. Distances and
angles are those of the published demonstrations; they were compared with the published joint paths.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from planning.errors import RobotModelError
from planning.handling.skill_targets import SkillTargets, Subgoal
from planning.lego.bricks.assembly import LAYER_HEIGHT, BrickType, Press
from planning.lego.bricks.brick_grips import grip_pose, side_contact_pose
from planning.lego.bricks.grid import box_from_top, brick_height
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


@dataclass(frozen=True)
class BrickGrip:
    """A brick that a tool holds by its edge at some pose.

    Attributes:
        frames: tool frames of the robot in its flange frame, ``RobotModel.frames``.
        brick: type of the brick.
        top: pose of the centre of its top face in the world.
        press: the grip, the same from pick to place.
    """

    frames: Mapping[str, Transform]
    brick: BrickType
    top: Transform
    press: Press

    @property
    def tool(self) -> Transform:
        """Pose of the frame ``"tool"`` that grips it from above."""
        return grip_pose(self.top, self.brick, self.press)

    @property
    def alt(self) -> Transform:
        """Pose of the frame ``"alt"`` that carries it on the side studs."""
        return side_contact_pose(self.top, self.brick, self.press)

    def place(self, *, up: bool) -> Subgoal:
        """Return the subgoal that releases the brick, pressed on from above or from below."""
        if up:
            return Subgoal("place", "alt", self.alt)
        return Subgoal("attach", "tool", self.tool)

    def held(self, *, up: bool = False) -> Transform:
        """Return the pose of its box centre in the flange frame, gripped or on the side studs."""
        goal = self.place(up=up)
        flange = goal.pose @ inverse(self.frame(goal.frame))
        return inverse(flange) @ box_from_top(self.top, self.brick)

    def via(self, pose: Transform, start: str, end: str) -> Transform:
        """Return the pose of tool frame ``end`` when ``start`` of the same tool is at ``pose``."""
        return pose @ inverse(self.frame(start)) @ self.frame(end)

    def frame(self, name: str) -> Transform:
        """Return a tool frame in the flange frame.

        Raises:
            RobotModelError: the robot does not have it.
        """
        if name not in self.frames:
            raise RobotModelError(
                f"the robot has no tool frame {name!r}, which the LEGO skills need",
                choices=tuple(sorted(self.frames)),
            )
        return self.frames[name]


def pick_targets(
    grip: BrickGrip, *, twist: float = DEFAULT_TWIST["pick"], by_halves: bool = False
) -> SkillTargets:
    """Return the subgoals of picking a brick up: approach, above, attach, twist, leave.

    Args:
        grip: of the brick where it is picked.
        twist: angle of the twist that loosens it [rad].
        by_halves: whether half way through the twist is a subgoal of its own: joints turning
            evenly lean the tool further over what stands beside the brick.
    """
    tool = grip.tool
    # The twist is about the bottom edge of a brick; that of a plate is nearer to the tool.
    nearer = LAYER_HEIGHT - brick_height(grip.brick)
    axis = grip.via(tool, "tool", "disassemble") @ translation(0.0, 0.0, -nearer)
    half, turned = (
        axis @ rotation("y", angle) @ translation(0.0, 0.0, nearer)
        for angle in (twist / 2, twist)
    )
    between = (Subgoal("half twist", "disassemble", half),) if by_halves else ()
    subgoals = (
        Subgoal("approach", "tool", tool @ translation(-0.005, 0.005, -0.0056)),
        Subgoal("above", "tool", tool @ translation(0.0, 0.0, -0.0028)),
        Subgoal("attach", "tool", tool),
        *between,
        Subgoal("twist", "disassemble", turned),
        Subgoal("leave", "disassemble", _lifted(turned)),
    )
    return SkillTargets("pick", subgoals, change_at=2)


def place_targets(
    grip: BrickGrip,
    *,
    up: bool,
    attack: int = 1,
    height: float = APPROACH_HEIGHT,
    twist: Mapping[str, float] = DEFAULT_TWIST,
) -> SkillTargets:
    """Return the subgoals of pressing a brick on, from above or from below.

    A place-down has approach, above, attach, half twist, twist, leave. Half way through the twist
    is a subgoal of its own: joints turning evenly from one end to the other would press the tool
    deeper into the brick on the way than at either end. A place-up, of a brick held from below on
    the side studs, has pre (20 mm before the approach), approach, below, place, twist, leave; the
    first two are transit goals in turn.

    Args:
        grip: of the brick in its place.
        up: True for a place-up.
        attack: +1 or -1, the side of the tool's y axis that the approach comes from.
        height: of the approach of a place-down above the goal [m].
        twist: angles of the twists that release it, by skill [rad].
    """
    goal = grip.place(up=up)
    if up:
        alt, sideways = goal.pose, -0.005 * attack
        axis = grip.via(alt, "alt", "alt_assemble")
        turned = axis @ rotation("y", twist["place-up"])
        subgoals = (
            Subgoal("pre", "alt", alt @ translation(0.0056, sideways, -0.025)),
            Subgoal("approach", "alt", alt @ translation(0.0056, sideways, -0.005)),
            Subgoal("below", "alt", alt @ translation(0.0028, 0.0, 0.0)),
            goal,
            Subgoal("twist", "alt_assemble", turned),
            Subgoal("leave", "alt_assemble", turned @ translation(_LIFT, 0.0, -_LIFT)),
        )
        return SkillTargets("place-up", subgoals, change_at=3, lead=2)
    tool, angle = goal.pose, -twist["place-down"]
    axis = grip.via(tool, "tool", "assemble")
    turned = axis @ rotation("y", angle)
    sideways = 0.005 * attack
    subgoals = (
        Subgoal("approach", "tool", tool @ translation(-0.005, sideways, -height)),
        Subgoal("above", "tool", tool @ translation(0.0, 0.0, -0.005)),
        goal,
        Subgoal("half twist", "assemble", axis @ rotation("y", angle / 2)),
        Subgoal("twist", "assemble", turned),
        Subgoal("leave", "assemble", _lifted(turned)),
    )
    return SkillTargets("place-down", subgoals, change_at=2)


def handover_targets(
    grip: BrickGrip, *, twist: float = DEFAULT_TWIST["handover"]
) -> SkillTargets:
    """Return the giver's subgoals of a handover: approach, press, twist, leave.

    Args:
        grip: the giver's, of the brick where it sits on the receiver's side studs; see
            ``received_top``.
        twist: angle of the twist that releases it [rad].
    """
    tool = grip.tool
    # The published twist also draws the tool back by 1 mm, and once more on leaving.
    back = translation(0.0, 0.0, -0.001)
    turned = grip.via(tool, "tool", "handover_assemble") @ rotation("y", -twist) @ back
    subgoals = (
        Subgoal("approach", "tool", tool @ translation(0.0, 0.0, -0.015)),
        Subgoal("press", "tool", tool),
        Subgoal("twist", "handover_assemble", turned),
        Subgoal("leave", "handover_assemble", _lifted(turned @ back)),
    )
    return SkillTargets("handover", subgoals, change_at=1)


def received_top(grip: BrickGrip, tool: Transform) -> Transform:
    """Return the pose of the top face of a handed-over brick while the receiver stands ready.

    Args:
        grip: the receiver's, of the brick in its place.
        tool: pose of the receiver's frame ``"tool"`` in the world as it receives.
    """
    return grip.via(tool, "tool", "alt") @ inverse(grip.alt) @ grip.top


def _lifted(pose: Transform) -> Transform:
    out = pose.copy()
    out[2, 3] += _LIFT
    return out
