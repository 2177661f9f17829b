"""Poses in which the tool grips and presses a brick, from above and from the side.

The z axis of the tool frame points out of the tool: down when it grips from above. Its origin is in the middle of the
edge of two neighbouring studs.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from planning.errors import ScenarioError
from planning.lego.bricks.assembly import (
    BRICK_LEVELS,
    LAYER_HEIGHT,
    STUD_PITCH,
    BrickType,
    Cell,
    OnGrid,
    Press,
)
from planning.lego.bricks.grid import brick_height
from planning.transforms import Transform, rotation, translation

SIDES = (1, 2, 3, 4)
"""Edges of a brick in its own axes: least x, greatest y, least y, greatest x."""

MOST_OFFSETS = 7
"""Number of offsets along the longest side, of eight studs, since a tool covers two of them."""

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


def legal_offsets(brick: BrickType, side: int) -> range:
    """Return the legal offsets along a side.

    The tool covers studs ``offset`` and ``offset + 1``. Along a side of a single stud there is
    one legal offset, 0; the tool is then off its middle and covers that stud alone.
    """
    return range(max(side_studs(brick, side) - 1, 1))


def legal_presses(brick: BrickType) -> tuple[Press, ...]:
    """Return all legal grips of a brick, at most 4 sides x 7 offsets, those on two studs first.

    Grips on one stud are listed only if no side of the brick has two studs. Along a side of more than
    eight studs the tool takes the first eight. There are none where a knob is missing.
    """
    every = [
        (side, off)
        for side in SIDES
        for off in legal_offsets(brick, side)[:MOST_OFFSETS]
    ]
    every = [own for own in every if has_knobs(brick, Press(*own))]
    wide = [(s, o) for s, o in every if side_studs(brick, s) >= 2]
    return tuple(Press(side, off) for side, off in (wide or every))


def has_knobs(brick: BrickType, press: Press) -> bool:
    """Tell whether a brick has the knobs that a grip covers."""
    length, (nx, ny) = side_studs(brick, press.side), brick.studs
    along = range(press.offset, min(press.offset + 2, length))
    across = {1: 0, 2: ny - 1, 3: 0, 4: nx - 1}[press.side]
    return brick.bare.isdisjoint(
        (across, k) if press.side in (1, 4) else (k, across) for k in along
    )


def check_press(brick: BrickType, press: Press) -> None:
    """Check that a grip exists on a brick.

    Raises:
        ScenarioError: the side or the offset does not exist; lists those that do.
    """
    legal = legal_offsets(brick, press.side)
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

    The tool is horizontal under the edge, with its side studs in the brick from below. The frame's origin is that of
    the grip from above on a brick of three levels; its z axis is horizontal and points into the brick, its x axis
    points down. The arguments are those of ``grip_pose``.
    """
    higher = translation(0.0, 0.0, LAYER_HEIGHT - brick_height(brick))
    return grip_pose(top @ higher, brick, press) @ _TO_SIDE_STUDS


def press_cell(item: OnGrid, press: Press, *, up: bool) -> Cell:
    """Return the contact of a press as the cell of a 1 x 2 brick.

    The cell lies along the pressed edge in the layer above the brick, or below it for a place-up, as in published
    task files. It is as high as a brick.
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
    """Return the cell next to a gripped edge, of a 1 x 2 brick, over which the tool's wall stands."""
    along_y, greatest = _edge(item.cell, press)
    out = 1 if greatest else -1
    edge = press_cell(item, press, up=False)
    x, y = (edge.x + out, edge.y) if along_y else (edge.x, edge.y + out)
    return replace(item.cell, x=x, y=y, turned=edge.turned)


def _edge(cell: Cell, press: Press) -> tuple[bool, bool]:
    """Tell whether a pressed edge runs along the grid's y, and whether it is the one of greatest x or y."""
    # A turned brick's least x is the grid's least y.
    along_y = press.side in ((2, 3) if cell.turned else (1, 4))
    greatest = press.side in ((3, 4) if cell.turned else (2, 4))
    return along_y, greatest
