"""Shape of an LDraw part: its body as a box, and the brick type that it is, if it is one.

A part is a brick where a tool can hold it as one: a box of whole studs and levels with knobs on the grid, two of them
side by side at an edge, or one at the end of a row. Beside the knobs its sides reach up to its top, and beside every
stud down to its bottom. All lengths are LDraw units, y points down.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from planning.lego.bricks.assembly import BrickType
from planning.lego.bricks.brick_grips import legal_presses
from planning.lego.bricks.brick_types import brick_of_size
from planning.transforms import Array

STUD, LEVEL = 20, 8
"""Distance of studs, and height of a plate; a brick is three times as high [LDraw units]."""

UNIT = np.array([STUD, LEVEL, STUD], dtype=np.float64)
"""Size of a place of the grid along x, y and z [LDraw units]."""

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
        bare: middles of the studs without a knob, shape (n, 3).
        reason: why it is no brick; nothing where it is one.
    """

    low: Array
    high: Array
    bare: Array
    reason: str = ""

    def placed(self, pose: Array) -> tuple[Array, Array]:
        """Return the least and greatest corner of the box that contains it at a pose, shape (4, 4)."""
        middle, half = (self.low + self.high) / 2, (self.high - self.low) / 2
        centre = pose[:3, :3] @ middle + pose[:3, 3]
        reach = np.abs(pose[:3, :3]) @ half
        return centre - reach, centre + reach

    def brick(self, pose: Array) -> tuple[BrickType, bool]:
        """Return the brick type that it is at an upright pose, and whether that is turned.

        The x and z axes of LDraw are the x and y axes of the grid.
        """
        low, high = self.placed(pose)
        nx, levels, ny = np.round((high - low) / UNIT).astype(int).tolist()
        bare = (self.bare @ pose[:3, :3].T + pose[:3, 3] - low)[:, [0, 2]] // STUD
        studs = {(i, j) for i, j in bare.astype(int).tolist()}
        if nx <= ny:
            return brick_of_size((nx, ny), levels, frozenset(studs)), False
        # The own axes of a turned brick: its x is the grid's y, its y points against the grid's x.
        own = frozenset((j, nx - 1 - i) for i, j in studs)
        return brick_of_size((ny, nx), levels, own), True


def brick_shape(brick: BrickType) -> PartShape:
    """Return the shape of a brick as LDraw draws it: along x, its origin in the middle of its top."""
    short, long = sorted(brick.studs)
    high = np.array([long, brick.height, short]) * UNIT * [0.5, 1.0, 0.5]
    return PartShape(high * [-1, 0, -1], high, np.zeros((0, 3)))


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
    nx, height, nz = (max(round(v), 1) for v in ((high - low) / UNIT).tolist())
    nothing = PartShape(low, high, np.zeros((0, 3)))
    if np.abs(high - low - UNIT * [nx, height, nz]).max() > _OFF:
        reason = "its box is not of whole studs and thirds of a brick"
        return replace(nothing, reason=reason)
    if max(nx, nz) > _MOST_STUDS or height > _MOST_LEVELS:
        reason = f"larger than {_MOST_STUDS} studs or {_MOST_LEVELS // 3} bricks"
        return replace(nothing, reason=reason)
    at = (foot[on_top] - low)[:, [0, 2]] / STUD - 0.5
    knobs = {(x, z) for x, z in np.round(at).astype(int).tolist()}
    places = set(product(range(nx), range(nz)))
    bare = [(x + 0.5, 0.0, z + 0.5) for x, z in sorted(places - knobs)]
    shape = replace(nothing, bare=low + np.reshape(bare, (-1, 3)) * UNIT)
    reason = ""
    if np.abs(at - np.round(at)).max(initial=0.0) > _OFF / STUD or not knobs <= places:
        reason = "its knobs are not on the grid of its studs"
    elif not legal_presses(shape.brick(np.eye(4))[0]):
        reason = "it has no knobs at an edge for the tool to hold"
    elif not _are_sides_closed(geometry.faces, low, high, knobs):
        reason = "its sides do not reach from its knobs to its bottom"
    return replace(shape, reason=reason)


def _are_sides_closed(
    faces: Array, low: Array, high: Array, knobs: Collection[tuple[int, int]]
) -> bool:
    """Tell whether the sides of a box have a face beside every stud near the bottom, and beside knobs near the top."""
    counts = np.round((high - low) / UNIT).astype(int).tolist()
    for axis, (end, row) in product((0, 2), ((low, 0), (high, -1))):
        flat = (np.abs(faces[:, :, axis] - end[axis]) <= _OFF).all(axis=1)
        along = 2 - axis
        corners = faces[flat][:, :, [along, 1]]
        for k in range(counts[along]):
            across = row % counts[axis]
            heights = [high[1] - _RIM]
            if ((across, k) if axis == 0 else (k, across)) in knobs:
                heights.append(low[1] + _RIM)
            for y in heights:
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
