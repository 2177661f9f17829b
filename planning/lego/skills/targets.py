"""The six manipulation skills as sequences of subgoals (APEX-MR Sec. V, App. C).

Every learned skill is an approach, an attach and a twist. The first subgoal, ``approach``, is
the goal of the transit before the skill; the skill's own reference path is the rest. Distances
and angles are those of the published demonstrations, checked against its shipped joint paths.

Allowed contacts are what touches by the nature of a skill: never arm and arm, never tool and tool. Everything is an
unordered pair of names: the robot's tool, a brick, the plate.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from planning.cell.workcell import Fixture
from planning.errors import RobotModelError
from planning.geometry.robot_bodies import entity_name
from planning.handling.skill_contacts import grip_contact
from planning.handling.skill_targets import SkillTargets, Subgoal
from planning.lego.bricks.assembly import (
    LAYER_HEIGHT,
    STUD_PITCH,
    BrickType,
    GridSpan,
    OnGrid,
    PlacedBrick,
    Plate,
    Press,
    Support,
)
from planning.lego.bricks.brick_grips import grip_pose, lever_cell, side_contact_pose
from planning.lego.bricks.brick_types import BRICKS
from planning.lego.bricks.grid import box_from_top, brick_height, plate_corner, top_pose
from planning.steps.skill import Pairs, contacts_with
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

LEVER_WALL = 0.0032
"""The wall beside the tool's grip stands out this far along the tool [m]."""

STUD_HEIGHT = 0.0017
"""Height of a stud [m]."""

_TOP_SHIFT = 0.002
"""The tool of a support-top stands this far inside the edge, along its x [m]."""

_BOTTOM_LEAD = 0.001
"""A support-bottom is approached from this far below [m]."""

_TOP_LEAD = 0.005
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

_TOUCH = 0.001
"""A fixture whose top is this near to a brick's bottom carries it [m]."""

PRESSED = 0.003
"""How deep a tool may go into bricks that it is allowed to touch: the audit lets pass as much [m]."""

Bricks = Mapping[str, OnGrid]


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
        shift = heading[:3, 0] * _TOP_SHIFT
        lift = frame[:3, 2] * (LEVER_WALL + STUD_HEIGHT - LAYER_HEIGHT)
        pose = heading @ _DOWN
        pose[:3, 3] = _contact(plate, support, z)[:3, 3] + shift + lift
        return (_support("support-top", pose, frame, (0.0, 0.0, _TOP_LEAD)),)
    up = frame[:3, 2] * (LAYER_HEIGHT - STUD_PITCH)
    pose = heading @ _LEVEL
    pose[:3, 3] = _contact(plate, support, z - 1)[:3, 3] + up
    pose = pose @ translation(0.0, 0.0, -LEVER_WALL)
    return tuple(
        _support(
            "support-bottom",
            pose,
            frame,
            (i * _BOTTOM_LEAD, j * _BOTTOM_LEAD, -_BOTTOM_LEAD),
        )
        for i, j in product((0, 1, -1), repeat=2)
    )


def lever_reaches_below(brick: BrickType) -> bool:
    """Tell whether the wall next to the tool's grip reaches the knobs below the brick."""
    return brick_height(brick) < LEVER_WALL + STUD_HEIGHT


def supported_span(support: Support) -> GridSpan:
    """Return the grid block of the supporting tip, two studs and a brick high."""
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


def resting_contacts(
    robot: str,
    item: PlacedBrick,
    pose: Transform,
    press: Press,
    others: Bricks,
    fixtures: Iterable[Fixture],
) -> Pairs:
    """Return the allowed contacts of a brick, and of the tool on it, at its pick or place.

    These are with each other; the bricks around; the fixtures that the brick stands on, plate, and
    table if level; for the tool the adjacent bricks: its lever wall reaches down along the gripped
    edge, and turns against what stands there. Along the edge of a plate it reaches to the bottom,
    where it touches what ends beside it: what the plate stands on, if that ends at the edge.

    Args:
        robot: the robot that picks or places.
        item: the brick where it is then.
        pose: of the centre of its box in the world.
        press: the grip.
        others: all other bricks at rest near ``resting_room``, or more.
        fixtures: of the cell.
    """
    name, span = item.name, item.span
    around = [other for other in _bordering(span, others, levels=1) if other != name]
    under = [one.name for one in fixtures if _carries(one, item.brick, pose)]
    neighbours = _bordering(span, others, levels=0)
    if lever_reaches_below(item.brick):
        lever = PlacedBrick("", BRICKS["1x2"], lever_cell(item, press)).span
        neighbours += [
            other
            for other in _bordering(lever, others, levels=1)
            if not lever.shares_studs(others[other].span)
        ]
    return (
        grip_contact(robot, name)
        | contacts_with(name, [*around, *under])
        | contacts_with(entity_name(robot, "tool"), neighbours)
    )


def neighbours_leaned_on(item: OnGrid, others: Bricks) -> frozenset[str]:
    """Return the bricks next to a picked brick, one stud away from it.

    The tool reaches one stud over the edge that it grips: it stands a tenth of a millimetre beside
    them, and the twist that loosens the brick leans it onto their upper edge, by 2.1 mm for 16
    degrees, and by some tenths more on the way where joints turn evenly. Published tasks pick bricks
    that stand so.
    """
    near = _bordering(item.span, others, levels=0)
    around = _bordering(item.span.widened(1), others, levels=0)
    return frozenset(around) - frozenset(near)


def resting_room(item: OnGrid) -> GridSpan:
    """Return the block of a brick at its pick or place, the tool's wall next to a plate included.

    Whatever resting_contacts names is near to it.
    """
    return item.span.widened(1) if lever_reaches_below(item.brick) else item.span


def support_contacts(robot: str, support: Support, bricks: Bricks) -> Pairs:
    """Return the contacts of a supporting tool with the supported bricks, and with their neighbours.

    A support-top presses on layer z - 1, a support-bottom on z + 1.
    """
    tip = supported_span(support)
    return contacts_with(entity_name(robot, "tool"), _bordering(tip, bricks, levels=1))


def _bordering(span: GridSpan, bricks: Bricks, *, levels: int) -> list[str]:
    """Return the bricks that share a face, an edge or a corner with a block of the grid.

    Edges and corners count because bricks are a fifth of a millimetre apart, less than the
    margin that planning keeps. Those above and below count where ``levels`` is 1.
    """
    return [
        name for name, item in bricks.items() if span.near(item.span, levels=levels)
    ]


def _carries(fixture: Fixture, brick: BrickType, pose: Transform) -> bool:
    bottom = pose[:3, 3] - pose[:3, 2] * brick_height(brick) / 2
    away = inverse(fixture.pose)
    local = away[:3, :3] @ bottom + away[:3, 3]
    half = fixture.size / 2
    inside = bool((abs(local[:2]) <= half[:2]).all())
    return inside and bool(abs(local[2] - half[2]) <= _TOUCH)
