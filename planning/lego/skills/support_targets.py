"""Poses of a supporting tool, above and below a structure, and the grid cells that its tip occupies."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np

from planning.handling.skill_targets import SkillTargets, Subgoal
from planning.lego.bricks.assembly import (
    LAYER_HEIGHT,
    STUD_PITCH,
    GridSpan,
    PlacedBrick,
    Plate,
    Press,
    Support,
)
from planning.lego.bricks.brick_grips import grip_pose
from planning.lego.bricks.brick_types import BRICKS
from planning.lego.bricks.grid import plate_corner, top_pose
from planning.transforms import Transform, rotation, translation

LEVER_WALL = 0.0032
"""Length of the wall beside the grip of the tool, along the tool [m]."""

STUD_HEIGHT = 0.0017
"""Height of a stud [m]."""

_TOP_SHIFT = 0.002
"""Distance of the tool of a support-top from the edge, inwards along its x axis [m]."""

_BOTTOM_LEAD = 0.001
"""Distance from below at which the approach of a support-bottom begins [m]."""

_TOP_LEAD = 0.005
"""Distance from above at which the approach of a support-top begins [m]."""

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
