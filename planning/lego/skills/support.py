"""Poses of the arm that supports a structure while another one presses (APEX-MR App. C).

Support-bottom holds the tool level under an overhang; support-top stands on the structure above
a brick that is pushed up from below. The supported place is a cell of 1 x 2 studs; the tool's
tip reaches its far edge.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from planning.errors import ScenarioError
from planning.lego.bricks.assembly import (
    BRICKS,
    LAYER_HEIGHT,
    STUD_PITCH,
    BrickType,
    Cell,
    Plate,
    Press,
    Support,
)
from planning.lego.bricks.grid import (
    Span,
    brick_height,
    occupied_span,
    plate_corner,
    top_pose,
)
from planning.lego.bricks.grips import grip_pose
from planning.skills.subgoals import SkillTargets, Subgoal
from planning.transforms import Transform, rotation, translation

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


def support_bottom_targets(plate: Plate, support: Support) -> tuple[SkillTargets, ...]:
    """Return the poses of a support from below.

    The top of the tool's tip, 16 mm wide, touches the bottom of the bricks in layer z + 1.

    Args:
        plate: the plate whose grid the support is given in.
        support: its cell and orientation, along the plate's axes. (The published code takes
            those of the first robot's base.)

    Returns:
        The support from each of nine pre-poses 1 mm lower: straight below first, then shifted
        by 1 mm.
    """
    frame = _axes(plate)
    up = frame[:3, 2] * (LAYER_HEIGHT - STUD_PITCH)
    pose = frame @ rotation("z", _YAW[_index(support)]) @ _LEVEL
    pose[:3, 3] = _contact(plate, support, support.z - 1)[:3, 3] + up
    pose = pose @ translation(0.0, 0.0, -LEVER_WALL)
    shifts = [(0.0, 0.0)] + [
        (i * BOTTOM_LEAD, j * BOTTOM_LEAD)
        for i in (0, 1, -1)
        for j in (0, 1, -1)
        if (i, j) != (0, 0)
    ]
    return tuple(
        _support("support-bottom", pose, frame, (dx, dy, -BOTTOM_LEAD))
        for dx, dy in shifts
    )


def support_top_targets(plate: Plate, support: Support) -> tuple[SkillTargets, ...]:
    """Return the poses of a support from above.

    The tool stands on the studs of the bricks in layer z - 1, pointing down.

    Args:
        plate: the plate whose grid the support is given in.
        support: its cell and orientation.

    Returns:
        The support from one pre-pose, 5 mm above it.
    """
    frame = _axes(plate)
    heading = rotation("z", _YAW[_index(support)])
    contact = _contact(plate, support, support.z)
    shift = (frame @ heading)[:3, 0] * TOP_SHIFT
    lift = frame[:3, 2] * (LEVER_WALL + STUD_HEIGHT - LAYER_HEIGHT)
    pose = frame @ heading @ _DOWN
    pose[:3, 3] = contact[:3, 3] + shift + lift
    return (_support("support-top", pose, frame, (0.0, 0.0, TOP_LEAD)),)


def lever_reaches_below(brick: BrickType) -> bool:
    """Tell whether the wall beside the tool's grip reaches the knobs of what a brick stands on."""
    return brick_height(brick) < LEVER_WALL + STUD_HEIGHT


def supported_span(support: Support) -> Span:
    """Return the room on the grid that the supporting tip takes up, two studs and a brick high."""
    return occupied_span(
        replace(support.cell, turned=_index(support) in (1, 2)), BRICKS["1x2"]
    )


def _contact(plate: Plate, support: Support, layer: int) -> Transform:
    k = _index(support)
    dx, dy = _BEHIND[k]
    cell = Cell(support.x + dx, support.y + dy, layer, k in (1, 2), support.raised)
    pair = BRICKS["1x2"]
    return grip_pose(top_pose(plate, cell, pair), pair, Press(_SIDE[k], 0))


def _axes(plate: Plate) -> Transform:
    out = plate_corner(plate).copy()
    out[:3, 3] = 0.0
    return out


def _support(
    skill: str, pose: Transform, frame: Transform, offset: tuple[float, float, float]
) -> SkillTargets:
    """Return a support that starts at an offset from its pose, given in a frame's axes."""
    pre = pose.copy()
    pre[:3, 3] += frame[:3, :3] @ np.asarray(offset)
    subgoals = (Subgoal("pre", "tool", pre), Subgoal("support", "tool", pose))
    return SkillTargets(skill, subgoals)


def _index(support: Support) -> int:
    if support.orientation not in ORIENTATIONS:
        raise ScenarioError(
            f"support orientation {support.orientation} does not exist",
            choices=tuple(str(k) for k in ORIENTATIONS),
        )
    return support.orientation
