"""The stud grid: poses of grid cells, and contacts between bricks.

Studs are not modelled: a brick is a box that is a tenth of a millimetre smaller on each side than the grid cells that
it fills.
"""

from __future__ import annotations

from collections.abc import Collection, Hashable, Mapping
from typing import TypeVar

import numpy as np

from planning.lego.bricks.assembly import (
    BRICK_LEVELS,
    LAYER_HEIGHT,
    STUD_PITCH,
    BrickType,
    GridPlace,
    OnGrid,
    Plate,
)
from planning.transforms import Array, Transform, rotation, translation

Key = TypeVar("Key", bound=Hashable)

_BRICK_GAP = 0.0002
"""Difference of a brick's length to its number of studs times the pitch [m]."""


def level_height(level: float) -> float:
    """Return the height of a level above the plate [m]."""
    return level / BRICK_LEVELS * LAYER_HEIGHT


def brick_height(brick: BrickType) -> float:
    """Return the height of a brick without its studs [m]."""
    return level_height(brick.height)


def box_size(brick: BrickType) -> Array:
    """Return the edge lengths of a brick's box in its own axes, shape (3,) [m]."""
    h, w = brick.studs
    return np.array(
        [h * STUD_PITCH - _BRICK_GAP, w * STUD_PITCH - _BRICK_GAP, brick_height(brick)]
    )


def plate_corner(plate: Plate) -> Transform:
    """Return the pose of the plate's corner at stud (0, 0), on the surface, in the world."""
    nx, ny = plate.studs
    return plate.pose @ translation(-nx * STUD_PITCH / 2, -ny * STUD_PITCH / 2, 0.0)


def top_pose(plate: Plate, item: OnGrid) -> Transform:
    """Return the pose of the centre of a brick's top face (studs excluded) in the world.

    The axes are the brick's own: x along ``studs[0]``, y along ``studs[1]``, z up. A turned
    brick is turned by +90 degrees about z; its cell still names the least stud it covers.
    """
    cell, (nx, ny) = item.cell, item.span.size
    x, y = (cell.x + nx / 2) * STUD_PITCH, (cell.y + ny / 2) * STUD_PITCH
    pose = plate_corner(plate) @ translation(x, y, level_height(item.span.top))
    return pose @ rotation("z", np.pi / 2) if cell.turned else pose


def box_pose(plate: Plate, item: OnGrid) -> Transform:
    """Return the pose of the centre of a brick's box in the world."""
    return box_from_top(top_pose(plate, item), item.brick)


def box_from_top(top: Transform, brick: BrickType) -> Transform:
    """Return the pose of the centre of a brick's box from that of its top face."""
    return top @ translation(0.0, 0.0, -brick_height(brick) / 2)


def bricks_above(item: OnGrid, others: Mapping[str, OnGrid]) -> tuple[str, ...]:
    """Return the names of the other bricks that stand on a brick, sorted."""
    return tuple(sorted(k for k, one in others.items() if item.span.carries(one.span)))


def bricks_joined_to_plate(
    places: Mapping[Key, frozenset[GridPlace]], base: Collection[GridPlace] = ()
) -> set[Key]:
    """Return the bricks that are connected to the plate, directly or through others.

    Args:
        places: grid places that each brick fills, by its key.
        base: grid places of what is connected to the plate in any case.
    """
    owner = {place: key for key, own in places.items() for place in own}
    held = {
        owner[x, y, k]
        for x, y, k in owner
        if k == 0 or (x, y, k - 1) in base or (x, y, k + 1) in base
    }
    front = list(held)
    while front:
        own = places[front.pop()]
        beyond = ((x, y, k + dk) for x, y, k in own for dk in (-1, 1))
        new = {owner[place] for place in beyond if place in owner} - held
        held |= new
        front += new
    return held
