"""Shape of an LDraw part: its body as a box, and the brick type that it is, if it is one.

A part is a brick where a tool can hold it as one: a box of whole studs and levels with a knob above every stud, and
sides that reach from its top to its bottom beside every stud. All lengths are LDraw units, y points down.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planning.lego.bricks.assembly import BrickType
from planning.lego.bricks.brick_types import brick_of_size
from planning.transforms import Array

STUD, LEVEL = 20, 8
"""Distance of studs, and height of a plate; a brick is three times as high [LDraw units]."""

_OFF = 0.5
"""How far a measure may be from a whole number of studs or levels, a fifth of a millimetre [LDraw units]."""

_RIM = 1.0
"""Distance from the top and the bottom of a side at which it is looked at [LDraw units]."""

_MOST_STUDS, _MOST_LEVELS = 48, 30
"""Greatest length and height of a brick."""

_KNOB = 4
"""Height of a knob [LDraw units]."""


@dataclass(frozen=True)
class PartGeometry:
    """Surface of a part.

    Attributes:
        faces: corners of triangles, shape (n, 3, 3).
        knobs: foot and direction of each knob, shape (m, 2, 3); they have no faces.
    """

    faces: Array
    knobs: Array


@dataclass(frozen=True)
class PartShape:
    """Box of a part in its own frame.

    Attributes:
        low, high: corners of the body, without the knobs on top, shape (3,).
        brick: its type, None where it is none.
        reason: why it is none.
    """

    low: Array
    high: Array
    brick: BrickType | None = None
    reason: str = ""

    def placed(self, pose: Array) -> tuple[Array, Array]:
        """Return the least and greatest corner of the box that contains it at a pose, shape (4, 4)."""
        middle, half = (self.low + self.high) / 2, (self.high - self.low) / 2
        centre = pose[:3, :3] @ middle + pose[:3, 3]
        reach = np.abs(pose[:3, :3]) @ half
        return centre - reach, centre + reach


def brick_shape(brick: BrickType) -> PartShape:
    """Return the shape of a brick as LDraw draws it: along x, its origin in the middle of its top."""
    short, long = sorted(brick.studs)
    high = np.array([long * STUD / 2, brick.height * LEVEL, short * STUD / 2])
    return PartShape(high * [-1, 0, -1], high, brick)


def part_shape(geometry: PartGeometry) -> PartShape | None:
    """Return the shape of a part, None where it has neither faces nor knobs."""
    foot, up = geometry.knobs[:, 0], geometry.knobs[:, 1]
    corners, tip = geometry.faces.reshape(-1, 3), foot + _KNOB * up
    if not len(corners) and not len(foot):
        return None
    top = float((corners if len(corners) else foot)[:, 1].min())
    # A knob that begins deeper in the body is as good as one on its top.
    upright = (np.abs(up[:, [0, 2]]) <= 0.01).all(axis=1)
    on_top = upright & (np.abs(tip[:, 1] - (top - _KNOB)) <= _OFF)
    corners = np.concatenate([corners, foot, tip[~on_top]])
    low, high = corners.min(axis=0), corners.max(axis=0)
    counts = (high - low) / [STUD, LEVEL, STUD]
    nx, height, nz = (max(round(v), 1) for v in counts.tolist())
    reason = ""
    if np.abs(high - low - [nx * STUD, height * LEVEL, nz * STUD]).max() > _OFF:
        reason = "its box is not of whole studs and thirds of a brick"
    elif max(nx, nz) > _MOST_STUDS or height > _MOST_LEVELS:
        reason = f"larger than {_MOST_STUDS} studs or {_MOST_LEVELS // 3} bricks"
    elif not _has_all_knobs(foot[on_top], low, nx, nz):
        reason = "it has not a knob above every stud for the tool to hold"
    elif not all(
        _is_side_closed(geometry.faces, low, high, axis, end, n)
        for axis, n in ((0, nz), (2, nx))
        for end in (low, high)
    ):
        reason = "its sides do not reach from top to bottom"
    if reason:
        return PartShape(low, high, None, reason)
    studs = (nx, nz) if nx <= nz else (nz, nx)
    return PartShape(low, high, brick_of_size(studs, height))


def _has_all_knobs(feet: Array, low: Array, nx: int, nz: int) -> bool:
    """Tell whether the knobs on top are those of all studs."""
    at = (feet - low)[:, [0, 2]] / STUD - 0.5
    places = np.round(at)
    if len(at) and np.abs(at - places).max() > _OFF / STUD:
        return False
    found = {(x, z) for x, z in places.astype(int).tolist()}
    return found == {(x, z) for x in range(nx) for z in range(nz)}


def _is_side_closed(
    faces: Array, low: Array, high: Array, axis: int, end: Array, studs: int
) -> bool:
    """Tell whether a side of the box has a face beside every stud, near its top and near its bottom.

    Args:
        faces: corners of triangles.
        low, high: corners of the box.
        axis: to which the side is at right angles, 0 or 2.
        end: the one of the corners that the side contains.
        studs: their number along the side.
    """
    flat = (np.abs(faces[:, :, axis] - end[axis]) <= _OFF).all(axis=1)
    along = 2 - axis
    corners = faces[flat][:, :, [along, 1]]
    for k in range(studs):
        for y in (low[1] + _RIM, high[1] - _RIM):
            point = np.array([low[along] + (k + 0.5) * STUD, y])
            if not _is_covered(corners, point):
                return False
    return True


def _is_covered(triangles: Array, point: Array) -> bool:
    """Tell whether a point is in one of some triangles, shape (n, 3, 2), of either direction."""
    edge = np.roll(triangles, -1, axis=1) - triangles
    to = point - triangles
    cross = edge[:, :, 0] * to[:, :, 1] - edge[:, :, 1] * to[:, :, 0]
    area = np.abs(cross.sum(axis=1))
    inside = (cross >= -1e-6).all(axis=1) | (cross <= 1e-6).all(axis=1)
    return bool((inside & (area > 1e-6)).any())
