"""The stud grid: from cells to poses, and which bricks touch.

Layers count from 1, so the top face of a brick of layer z is z layer heights above the plate and
its bottom face z - 1. Studs are not modelled: bricks are boxes a tenth of a millimetre smaller
on each side than their share of the grid.
"""

from __future__ import annotations

from collections.abc import Collection, Hashable, Mapping
from functools import lru_cache
from typing import TypeVar

import numpy as np

from planning.lego.bricks.assembly import (
    LAYER_HEIGHT,
    STUD_PITCH,
    BrickType,
    Cell,
    Plate,
)
from planning.transforms import Array, Transform, rotation, translation

Stud = tuple[int, int, int]
"""A place on the grid: stud in x and y from 0, layer from 1."""

Key = TypeVar("Key", bound=Hashable)

BRICK_GAP = 0.0002
"""A brick is this much shorter than its studs times the pitch [m]."""


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


@lru_cache(maxsize=20_000)
def occupied_studs(cell: Cell, brick: BrickType) -> frozenset[Stud]:
    """Return the (x, y, z) of every grid place that a brick fills."""
    nx, ny = footprint(cell, brick)
    return frozenset(
        (cell.x + i, cell.y + j, cell.z) for i in range(nx) for j in range(ny)
    )


def bricks_above(
    cell: Cell, brick: BrickType, others: Mapping[str, tuple[Cell, BrickType]]
) -> tuple[str, ...]:
    """Return the names of the other bricks that stand on a brick at a cell, sorted."""
    over = frozenset((x, y, z + 1) for x, y, z in occupied_studs(cell, brick))
    found = (k for k, other in others.items() if over & occupied_studs(*other))
    return tuple(sorted(found))


def joined_to_plate(
    studs: Mapping[Key, frozenset[Stud]], base: Collection[Stud] = ()
) -> set[Key]:
    """Return the bricks that are joined to the plate, or to others that are, one on the other.

    Args:
        studs: the places on the grid that each brick fills.
        base: places that are filled by what stands in any case.
    """
    owner = {stud: key for key, own in studs.items() for stud in own}
    held = {
        owner[x, y, z]
        for x, y, z in owner
        if z == 1 or (x, y, z - 1) in base or (x, y, z + 1) in base
    }
    front = list(held)
    while front:
        own = studs[front.pop()]
        beyond = ((x, y, z + dz) for x, y, z in own for dz in (-1, 1))
        new = {owner[stud] for stud in beyond if stud in owner} - held
        held |= new
        front += new
    return held
