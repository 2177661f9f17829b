"""The stud grid: from cells to poses, and which bricks touch.

Heights count in levels, thirds of a brick: a brick of layer z stands on level 3 (z - 1) and its top
face is at level 3 z, one level higher for each that it is raised. Studs are not modelled: bricks
are boxes a tenth of a millimetre smaller on each side than their share of the grid.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Hashable, Iterable, Iterator, Mapping
from functools import lru_cache
from itertools import product
from typing import NamedTuple, TypeVar

import numpy as np

from planning.lego.bricks.assembly import (
    BRICK_LEVELS,
    LAYER_HEIGHT,
    STUD_PITCH,
    BrickType,
    Cell,
    Plate,
)
from planning.transforms import Array, Transform, rotation, translation

GridPlace = tuple[int, int, int]
"""A place on the grid: stud in x and y from 0, level from 0 on the plate."""

Key = TypeVar("Key", bound=Hashable)

BRICK_GAP = 0.0002
"""A brick is this much shorter than its studs times the pitch [m]."""


class GridSpan(NamedTuple):
    """The room of a brick on the grid: from where to before where, in studs and levels."""

    x0: int
    x1: int
    y0: int
    y1: int
    bottom: int
    top: int

    @property
    def places(self) -> frozenset[GridPlace]:
        """The (x, y, level) of every place on the grid in it."""
        xs, ys = range(self.x0, self.x1), range(self.y0, self.y1)
        return frozenset(product(xs, ys, range(self.bottom, self.top)))

    def widened(self, studs: int) -> GridSpan:
        """Return the room that reaches some studs further along x and y."""
        return GridSpan(
            self.x0 - studs,
            self.x1 + studs,
            self.y0 - studs,
            self.y1 + studs,
            self.bottom,
            self.top,
        )

    def near(self, other: GridSpan, *, levels: int) -> bool:
        """Tell whether another room begins within a stud beside, and so many levels above or below."""
        return (
            self.x0 <= other.x1
            and other.x0 <= self.x1
            and self.y0 <= other.y1
            and other.y0 <= self.y1
            and self.bottom < other.top + levels
            and other.bottom < self.top + levels
        )

    def carries(self, other: GridSpan) -> bool:
        """Tell whether another brick stands on this one."""
        return other.bottom == self.top and self.shares_studs(other)

    def shares_studs(self, other: GridSpan) -> bool:
        """Tell whether another room is over or under this one, or in it."""
        return (
            self.x0 < other.x1
            and other.x0 < self.x1
            and self.y0 < other.y1
            and other.y0 < self.y1
        )


def level_height(level: float) -> float:
    """Return the height of a level above the plate [m]."""
    return level / BRICK_LEVELS * LAYER_HEIGHT


def brick_height(brick: BrickType) -> float:
    """Return the height of a brick without its studs [m]."""
    return level_height(brick.height)


def footprint(cell: Cell, brick: BrickType) -> tuple[int, int]:
    """Return the studs a brick covers along the grid's x and y."""
    h, w = brick.studs
    return (w, h) if cell.turned else (h, w)


def box_size(brick: BrickType) -> Array:
    """Return the edge lengths of a brick's box in its own axes, shape (3,) [m]."""
    h, w = brick.studs
    return np.array(
        [h * STUD_PITCH - BRICK_GAP, w * STUD_PITCH - BRICK_GAP, brick_height(brick)]
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
        level_height(cell.level + brick.height),
    )
    pose = plate_corner(plate) @ centre
    return pose @ rotation("z", np.pi / 2) if cell.turned else pose


def box_pose(plate: Plate, cell: Cell, brick: BrickType) -> Transform:
    """Return the pose of the centre of a brick's box in the world."""
    return box_from_top(top_pose(plate, cell, brick), brick)


def box_from_top(top: Transform, brick: BrickType) -> Transform:
    """Return the pose of the centre of a brick's box from that of its top face."""
    return top @ translation(0.0, 0.0, -brick_height(brick) / 2)


@lru_cache(maxsize=20_000)
def occupied_span(cell: Cell, brick: BrickType) -> GridSpan:
    """Return the room of a brick on the grid."""
    nx, ny = footprint(cell, brick)
    x, y, level = cell.x, cell.y, cell.level
    return GridSpan(x, x + nx, y, y + ny, level, level + brick.height)


@lru_cache(maxsize=20_000)
def covered_studs(cell: Cell, brick: BrickType) -> frozenset[tuple[int, int]]:
    """Return the (x, y) of every stud that a brick covers."""
    x0, x1, y0, y1, *_ = occupied_span(cell, brick)
    return frozenset((x, y) for x in range(x0, x1) for y in range(y0, y1))


@lru_cache(maxsize=20_000)
def occupied_places(cell: Cell, brick: BrickType) -> frozenset[GridPlace]:
    """Return the (x, y, level) of every place on the grid that a brick fills."""
    return occupied_span(cell, brick).places


def bricks_above(
    cell: Cell, brick: BrickType, others: Mapping[str, tuple[Cell, BrickType]]
) -> tuple[str, ...]:
    """Return the names of the other bricks that stand on a brick at a cell, sorted."""
    span = occupied_span(cell, brick)
    found = (k for k, other in others.items() if span.carries(occupied_span(*other)))
    return tuple(sorted(found))


def joined_to_plate(
    places: Mapping[Key, frozenset[GridPlace]], base: Collection[GridPlace] = ()
) -> set[Key]:
    """Return the bricks that are joined to the plate, or to others that are, one on the other.

    Args:
        places: the places on the grid that each brick fills.
        base: places that are filled by what stands in any case.
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


_TILE = 8
"""Studs along the edge of a tile."""

Numbered = tuple[int, str, Cell, BrickType]
"""A brick with its place in some order, its name, and where it is."""


class BrickTiles:
    """Bricks on one plate, found by where they are.

    Args:
        bricks: each with its place in an order; several may be in one place, at different times.
    """

    def __init__(self, bricks: Iterable[Numbered]) -> None:
        self._tiles: dict[tuple[int, int], list[tuple[GridSpan, Numbered]]] = (
            defaultdict(list)
        )
        for item in bricks:
            span = occupied_span(item[2], item[3])
            for tile in _tiles(span):
                self._tiles[tile].append((span, item))

    def near(self, span: GridSpan, before: int) -> dict[str, tuple[Cell, BrickType]]:
        """Return the bricks on, under and within a stud beside some room, in their order.

        Args:
            span: the room.
            before: only bricks that are before this in the order.
        """
        found = {
            item
            for tile in _tiles(span)
            for other, item in self._tiles.get(tile, ())
            if item[0] < before and span.near(other, levels=1)
        }
        return {name: (cell, kind) for _, name, cell, kind in sorted(found, key=_order)}


def _order(item: Numbered) -> tuple[int, str]:
    return item[0], item[1]


def _tiles(span: GridSpan) -> Iterator[tuple[int, int]]:
    """Yield the tiles of some room and of a stud beside it."""
    for x in range((span.x0 - 1) // _TILE, (span.x1 + 1) // _TILE + 1):
        for y in range((span.y0 - 1) // _TILE, (span.y1 + 1) // _TILE + 1):
            yield x, y
