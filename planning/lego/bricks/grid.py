"""The stud grid: from cells to poses and back, and which bricks touch.

Layers count from 1, so the top face of a brick of layer z is z layer heights above the plate and
its bottom face z - 1. Studs are not modelled: bricks are boxes a tenth of a millimetre smaller
on each side than their share of the grid.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from planning.errors import ScenarioError
from planning.lego.bricks.assembly import (
    LAYER_HEIGHT,
    STUD_PITCH,
    BrickType,
    Cell,
    Plate,
)
from planning.transforms import Array, Transform, inverse, rotation, translation

BRICK_GAP = 0.0002
"""A brick is this much shorter than its studs times the pitch [m]."""


@dataclass(frozen=True)
class Neighbours:
    """The bricks that share a face, or part of one, with a brick.

    Attributes:
        below: names of the bricks it stands on, sorted.
        above: names of the bricks that stand on it, sorted.
        beside: names of the bricks next to it in its own layer, sorted.
    """

    below: tuple[str, ...]
    above: tuple[str, ...]
    beside: tuple[str, ...]


def footprint(cell: Cell, brick: BrickType) -> tuple[int, int]:
    """Return the studs a brick covers along the grid's x and y."""
    h, w = brick.studs
    return (w, h) if cell.turned else (h, w)


def box_size(brick: BrickType) -> Array:
    """Return the edge lengths of a brick's box in its own axes, shape (3,) [m]."""
    h, w = brick.studs
    return np.array(
        [h * STUD_PITCH - BRICK_GAP, w * STUD_PITCH - BRICK_GAP, LAYER_HEIGHT]
    )


def plate_corner(plate: Plate) -> Transform:
    """Return the pose of the plate's corner at stud (0, 0), on the surface, in the world."""
    nx, ny = plate.studs
    return plate.pose @ translation(-nx * STUD_PITCH / 2, -ny * STUD_PITCH / 2, 0.0)


def top_pose(plate: Plate, cell: Cell, brick: BrickType) -> Transform:
    """Return the pose of the centre of a brick's top face (studs excluded) in the world.

    The axes are the brick's own: x along ``studs[0]``, y along ``studs[1]``, z up. A turned
    brick is turned by +90 degrees about z; its cell still names the least stud it covers.
    """
    nx, ny = footprint(cell, brick)
    centre = translation(
        (cell.x + nx / 2) * STUD_PITCH,
        (cell.y + ny / 2) * STUD_PITCH,
        cell.z * LAYER_HEIGHT,
    )
    pose = plate_corner(plate) @ centre
    return pose @ rotation("z", np.pi / 2) if cell.turned else pose


def box_pose(plate: Plate, cell: Cell, brick: BrickType) -> Transform:
    """Return the pose of the centre of a brick's box in the world."""
    return box_from_top(top_pose(plate, cell, brick))


def box_from_top(top: Transform) -> Transform:
    """Return the pose of a box's centre from that of its top face."""
    return top @ translation(0.0, 0.0, -LAYER_HEIGHT / 2)


def top_from_box(box: Transform) -> Transform:
    """Return the pose of a box's top face from that of its centre."""
    return box @ translation(0.0, 0.0, LAYER_HEIGHT / 2)


def cell_at(
    plate: Plate, top: Transform, brick: BrickType, *, tolerance: float = 1e-6
) -> Cell:
    """Return the cell of a brick whose top face has a pose: the inverse of ``top_pose``.

    Poses turned by 180 or 270 degrees give the cell of the same box turned by 0 or 90.

    Args:
        plate: the plate whose grid is meant.
        top: pose of the centre of the top face in the world.
        brick: its type.
        tolerance: largest distance from the grid [m], and largest misalignment [rad].

    Raises:
        ScenarioError: the pose is not on the grid.
    """
    local = inverse(plate_corner(plate)) @ top
    quarter = np.arctan2(local[1, 0], local[0, 0]) / (np.pi / 2)
    turns = round(quarter)
    upright = rotation("z", turns * np.pi / 2)[:3, :3]
    turned = turns % 2 == 1
    nx, ny = footprint(Cell(0, 0, 1, turned), brick)
    x = local[0, 3] / STUD_PITCH - nx / 2
    y = local[1, 3] / STUD_PITCH - ny / 2
    z = local[2, 3] / LAYER_HEIGHT
    cell = Cell(round(x), round(y), round(z), turned)
    off = max(
        abs(x - cell.x) * STUD_PITCH,
        abs(y - cell.y) * STUD_PITCH,
        abs(z - cell.z) * LAYER_HEIGHT,
        float(np.abs(local[:3, :3] - upright).max()),
    )
    if off > tolerance:
        raise ScenarioError(f"the pose is {off:.2g} off the stud grid")
    return cell


@lru_cache(maxsize=20_000)
def occupied_studs(cell: Cell, brick: BrickType) -> frozenset[tuple[int, int, int]]:
    """Return the (x, y, z) of every grid place that a brick fills."""
    nx, ny = footprint(cell, brick)
    return frozenset(
        (cell.x + i, cell.y + j, cell.z) for i in range(nx) for j in range(ny)
    )


def on_plate(plate: Plate, cell: Cell, brick: BrickType) -> bool:
    """Return True when the whole brick lies over the plate, in layer 1 or above."""
    nx, ny = footprint(cell, brick)
    return (
        cell.x >= 0
        and cell.y >= 0
        and cell.z >= 1
        and cell.x + nx <= plate.studs[0]
        and cell.y + ny <= plate.studs[1]
    )


def overlapping(
    cell: Cell,
    brick: BrickType,
    others: Mapping[str, tuple[Cell, BrickType]],
) -> tuple[str, ...]:
    """Return the names of the other bricks that fill a place this one fills, sorted."""
    return _names_at(occupied_studs(cell, brick), others)


def neighbours(
    cell: Cell,
    brick: BrickType,
    others: Mapping[str, tuple[Cell, BrickType]],
) -> Neighbours:
    """Return the bricks that touch a brick at a cell: below, above and beside it.

    Args:
        cell: where the brick is.
        brick: its type.
        others: every other brick by name, with its cell and type.
    """
    own = occupied_studs(cell, brick)
    side = {
        (x + dx, y + dy, z)
        for x, y, z in own
        for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1))
    }
    return Neighbours(
        below=_names_at(frozenset((x, y, z - 1) for x, y, z in own), others),
        above=_names_at(frozenset((x, y, z + 1) for x, y, z in own), others),
        beside=_names_at(frozenset(side - own), others),
    )


def _names_at(
    places: frozenset[tuple[int, int, int]],
    others: Mapping[str, tuple[Cell, BrickType]],
) -> tuple[str, ...]:
    return tuple(
        sorted(
            name
            for name, (cell, brick) in others.items()
            if not places.isdisjoint(occupied_studs(cell, brick))
        )
    )
