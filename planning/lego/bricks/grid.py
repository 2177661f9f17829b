"""The stud grid: from cells to poses, and which bricks touch.

Studs are not modelled: bricks are boxes a tenth of a millimetre smaller on each side than their
share of the grid.

Poses in which the tool grips and presses a brick, from above and from the side.

The tool frame has z along the tool, out of it: down when it grips from above. It stands on the
middle of the edge of two neighbouring studs.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Hashable, Iterable, Iterator, Mapping
from dataclasses import replace
from typing import TypeVar

import numpy as np

from planning.errors import ScenarioError
from planning.lego.bricks.assembly import (
    BRICK_LEVELS,
    LAYER_HEIGHT,
    STUD_PITCH,
    BrickType,
    Cell,
    GridPlace,
    GridSpan,
    OnGrid,
    PlacedBrick,
    Plate,
    Press,
)
from planning.transforms import Array, Transform, rotation, translation

Key = TypeVar("Key", bound=Hashable)

BRICK_GAP = 0.0002
"""A brick is this much shorter than its studs times the pitch [m]."""


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
        [h * STUD_PITCH - BRICK_GAP, w * STUD_PITCH - BRICK_GAP, brick_height(brick)]
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


def joined_to_plate(
    places: Mapping[Key, frozenset[GridPlace]], base: Collection[GridPlace] = ()
) -> set[Key]:
    """Return the bricks that are joined to the plate, or to others that are, one on the other.

    Each is given with the places that it fills; what stands in any case fills those of the base.
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

Numbered = tuple[int, PlacedBrick]
"""A brick with its place in some order."""


class BrickTiles:
    """Bricks on one plate, found by where they are.

    Args:
        bricks: each with its place in an order; several may be in one place, at different times.
    """

    def __init__(self, bricks: Iterable[Numbered]) -> None:
        self._tiles: dict[tuple[int, int], list[Numbered]] = defaultdict(list)
        for item in bricks:
            for tile in _tiles(item[1].span):
                self._tiles[tile].append(item)

    def near(self, span: GridSpan, before: int) -> dict[str, PlacedBrick]:
        """Return the bricks within a stud of some room that are before a place in their order."""
        found = {
            (number, item.name): item
            for tile in _tiles(span)
            for number, item in self._tiles.get(tile, ())
            if number < before and span.near(item.span, levels=1)
        }
        return {name: found[number, name] for number, name in sorted(found)}


def _tiles(span: GridSpan) -> Iterator[tuple[int, int]]:
    """Yield the tiles of some room and of a stud beside it."""
    for x in range((span.x0 - 1) // _TILE, (span.x1 + 1) // _TILE + 1):
        for y in range((span.y0 - 1) // _TILE, (span.y1 + 1) // _TILE + 1):
            yield x, y


SIDES = (1, 2, 3, 4)
"""Edges of a brick in its own axes: least x, greatest y, least y, greatest x."""

MOST_OFFSETS = 7
"""Offsets of the longest side, eight studs: a tool covers two of them."""

_FLIP = rotation("y", np.pi)
_HALF_TURN = rotation("z", np.pi)
_QUARTER_TURN = rotation("z", np.pi / 2)
_TO_SIDE_STUDS = rotation("y", np.pi / 2) @ rotation("z", np.pi)


def side_studs(brick: BrickType, side: int) -> int:
    """Return the number of studs along a side (1 to 4) of a brick."""
    if side not in SIDES:
        raise ScenarioError(
            f"press side {side} does not exist", choices=tuple(str(s) for s in SIDES)
        )
    h, w = brick.studs
    return w if side in (1, 4) else h


def offsets(brick: BrickType, side: int) -> range:
    """Return the legal offsets along a side.

    The tool covers studs ``offset`` and ``offset + 1``. Along a side of a single stud there is
    one legal offset, 0; the tool then stands off the middle and covers that stud alone.
    """
    return range(max(side_studs(brick, side) - 1, 1))


def presses(brick: BrickType) -> tuple[Press, ...]:
    """Return all legal grips of a brick, at most 4 sides x 7 offsets, those of two studs first.

    Grips of one stud are listed only where the brick has no side of two.
    """
    every = [(side, off) for side in SIDES for off in offsets(brick, side)]
    wide = [(s, o) for s, o in every if side_studs(brick, s) >= 2]
    return tuple(Press(side, off) for side, off in (wide or every))


def check_press(brick: BrickType, press: Press) -> None:
    """Check that a grip exists on a brick.

    Raises:
        ScenarioError: the side or the offset does not exist; lists those that do.
    """
    legal = offsets(brick, press.side)
    if press.offset not in legal:
        raise ScenarioError(
            f"press offset {press.offset} does not exist on side {press.side} of a "
            f"{brick.name} brick",
            choices=tuple(str(k) for k in legal),
        )


def grip_pose(top: Transform, brick: BrickType, press: Press) -> Transform:
    """Return the pose of the frame ``"tool"`` that grips or presses a brick from above.

    Args:
        top: pose of the centre of the brick's top face, see ``top_pose``.
        brick: its type.
        press: side and offset.

    Returns:
        The pose in the frame of ``top``'s parent: origin on the top edge, z down, x towards
        the middle of the brick.
    """
    check_press(brick, press)
    h, w = (n * STUD_PITCH for n in brick.studs)
    reach = (press.offset + 1) * STUD_PITCH
    flipped = top @ _FLIP
    if press.side == 1:
        return flipped @ translation(h / 2, reach - w / 2, 0) @ _HALF_TURN
    if press.side == 2:
        edge = translation(h / 2 - reach, w / 2, 0)
        return flipped @ edge @ _HALF_TURN @ _QUARTER_TURN
    if press.side == 3:
        return flipped @ translation(h / 2 - reach, -w / 2, 0) @ _QUARTER_TURN
    return flipped @ translation(-h / 2, reach - w / 2, 0)


def side_contact_pose(top: Transform, brick: BrickType, press: Press) -> Transform:
    """Return the pose of the frame ``"alt"`` that carries a brick on the side studs.

    The tool lies level under the edge, its side studs in the brick from below: the frame's
    origin is where the top grip's would be on a brick three levels high, its z points level into
    the brick, its x down. What it is given is that of ``grip_pose``.
    """
    higher = translation(0.0, 0.0, LAYER_HEIGHT - brick_height(brick))
    return grip_pose(top @ higher, brick, press) @ _TO_SIDE_STUDS


def press_cell(item: OnGrid, press: Press, *, up: bool) -> Cell:
    """Return the contact of a press as the cell of a 1 x 2 brick.

    It lies along the pressed edge in the layer above the brick, or below it for a place-up,
    as published task files give it. It is as high as a brick.
    """
    check_press(item.brick, press)
    cell, (nx, ny) = item.cell, item.span.size
    along_y, greatest = _edge(cell, press)
    from_end = cell.turned and press.side in (1, 4)
    length = ny if along_y else nx
    start = length - press.offset - 2 if from_end else press.offset
    across = (nx if along_y else ny) - 1 if greatest else 0
    dx, dy = (across, start) if along_y else (start, across)
    level = cell.level - BRICK_LEVELS if up else item.span.top
    return Cell.at_level(cell.x + dx, cell.y + dy, level, turned=not along_y)


def lever_cell(item: OnGrid, press: Press) -> Cell:
    """Return the cell beside a gripped edge, of a 1 x 2 brick, over which the tool's wall stands."""
    along_y, greatest = _edge(item.cell, press)
    out = 1 if greatest else -1
    edge = press_cell(item, press, up=False)
    x, y = (edge.x + out, edge.y) if along_y else (edge.x, edge.y + out)
    return replace(item.cell, x=x, y=y, turned=edge.turned)


def _edge(cell: Cell, press: Press) -> tuple[bool, bool]:
    """Tell of a pressed edge whether it runs along the grid's y, and is that of greatest x or y."""
    # A turned brick's least x is the grid's least y.
    along_y = press.side in ((2, 3) if cell.turned else (1, 4))
    greatest = press.side in ((3, 4) if cell.turned else (2, 4))
    return along_y, greatest
