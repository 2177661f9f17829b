"""Handovers of a brick between two robots: meeting poses and arm postures.

The tool of the receiver is horizontal and points to the giver, with its side studs up. The giver approaches from
above. The meeting place of APEX-MR is tried first, then others in the vertical plane between the two bases,
the nearest ones first.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import numpy as np

from planning.cell.workcell import Attachment, PlacedRobot
from planning.handling.handovers import MeetingPlace
from planning.handling.skill_targets import Subgoal
from planning.lego.bricks.assembly import Press
from planning.lego.bricks.brick_world import BrickWorld
from planning.lego.bricks.grid import box_from_top
from planning.lego.skills.targets import BrickGrip, handover_targets, received_top
from planning.transforms import Array, Transform, rotation, translation

REACH = 0.45
"""Distance of the receiving tool from the receiver's base axis [m]."""

HEIGHT = 0.35
"""Height of the receiving tool above the receiver's base [m]."""

_DRAW_BACK = 0.075
"""Distance behind the meeting place at which the receiver waits before and after a handover [m]."""

_REST = (0.2, 0.0, 0.5)
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
    """Return candidate poses to receive a brick, in the order to try, given both base poses in the world.

    Returns:
        Candidates (pre, receive), the same list for the same bases: the tool drawn back, where
        it comes from and goes to with the brick, and held still while the brick is pressed onto
        its side studs. The first is the published one, 0.45 m in front of the receiver's base
        and 0.35 m up, towards the giver. Where the base's x axis points to the giver within 10
        degrees, it gives the direction, as published; the exact bearing follows.
    """
    away = receiver[:3, :3].T @ (giver[:3, 3] - receiver[:3, 3])
    bearing = float(np.arctan2(away[1], away[0]))
    directions = [bearing]
    if abs(bearing) < _FACING:
        directions = [0.0] if abs(bearing) < 1e-9 else [0.0, bearing]
    half = 0.5 * float(np.linalg.norm((giver - receiver)[:2, 3]))
    reaches = sorted({*_REACHES, round(half, 3)}, key=lambda r: (abs(r - REACH), r))
    places = sorted(
        product(reaches, _HEIGHTS, directions),
        key=lambda p: round(abs(p[0] - REACH) + abs(p[1] - HEIGHT), 6),
    )
    back = translation(0.0, 0.0, -_DRAW_BACK)
    out = []
    for reach, height, direction in places:
        turned = receiver @ rotation("z", direction)
        tool = turned @ translation(reach, 0.0, height) @ _LEVEL
        pre = Subgoal("pre-receive", "tool", tool @ back)
        out.append((pre, Subgoal("receive", "tool", tool)))
    return tuple(out)


def giver_rest_poses(giver: Transform) -> Subgoal:
    """Return the giver's flange poses before and after a handover, pointing down."""
    pose = giver @ translation(*_REST) @ rotation("x", np.pi)
    return Subgoal("handover rest", "flange", pose)


def brick_meetings(
    world: BrickWorld,
    robots: tuple[PlacedRobot, PlacedRobot],
    step: int,
    press: Press,
    rest: Array,
) -> Iterator[MeetingPlace]:
    """Yield candidate handover places of a step's brick, in the order to try.

    Args:
        world: cell and assembly.
        robots: giver and receiver.
        step: of the brick, counted from 1.
        press: the grip.
        rest: where the giver stands before and after, shape (n,).
    """
    giver, receiver = robots
    kind, twist = world.step(step).brick, world.assembly.twist["handover"]
    goal = BrickGrip(receiver.model.frames, kind, world.goal_top(step), press)
    taken = Attachment(receiver.name, goal.held(up=True))
    for pre, receive in receive_poses(receiver.base, giver.base):
        top = received_top(goal, receive.pose)
        grip = BrickGrip(giver.model.frames, kind, top, press)
        yield MeetingPlace(
            giver,
            receiver,
            world.goal(step)[0],
            Attachment(giver.name, grip.held()),
            taken,
            box_from_top(top, kind),
            pre,
            receive,
            handover_targets(grip, twist=twist),
            rest,
        )
