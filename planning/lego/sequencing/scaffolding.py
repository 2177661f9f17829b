"""Temporary bricks under bricks that could not go in otherwise: scaffolding from the stock.

A brick that hangs below others, near the plate where no tool gets under it, or that sticks out so
far that the structure gives way under the press, is carried by a column of bricks from below while
the structure is built. Such a column is held by knobs above and below: it stays until the model
is lifted off the plate, and is then pulled off from below.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace

from planning.lego.bricks.assembly import BrickType, Cell, PlacedBrick
from planning.lego.bricks.grid import Place, footprint, occupied_places


def columns_below(
    item: PlacedBrick, filled: Mapping[Place, str], types: Collection[BrickType]
) -> Iterator[tuple[PlacedBrick, ...]]:
    """Yield columns that would carry a brick where there is nothing below it, the widest first.

    Args:
        item: the brick.
        filled: the brick in each place of the grid.
        types: of bricks that there are.

    Yields:
        The bricks of a column from the top down, named after the brick and their layer.
    """
    x0, y0, top = item.cell.x, item.cell.y, item.cell.level
    nx, ny = footprint(item.cell, item.brick)
    free = {
        (x, y)
        for x in range(x0, x0 + nx)
        for y in range(y0, y0 + ny)
        if top > 0 and (x, y, top - 1) not in filled
    }
    heights: dict[tuple[tuple[int, int], bool], dict[int, BrickType]] = {}
    for brick in types:
        for turned in (False, True) if brick.studs[0] != brick.studs[1] else (False,):
            size = footprint(Cell(0, 0, 1, turned), brick)
            heights.setdefault((size, turned), {})[brick.height] = brick

    def order(size: tuple[tuple[int, int], bool]) -> tuple[int, int, bool]:
        (w, d), turned = size
        return -w * d, abs(w - d), turned

    for (w, d), turned in sorted(heights, key=order):
        for x, y in sorted(free):
            patch = {(x + i, y + j) for i in range(w) for j in range(d)}
            if patch <= free:
                column = _column(x, y, top, turned, heights[(w, d), turned], filled)
                if column:
                    free -= patch
                    yield tuple(
                        replace(part, name=f"under {item.name}: {part.cell.words}")
                        for part in column
                    )


def _column(
    x: int,
    y: int,
    top: int,
    turned: bool,
    heights: Mapping[int, BrickType],
    filled: Mapping[Place, str],
) -> list[PlacedBrick]:
    """Return a column up to a level from what stands below it; none where heights do not add up."""
    column: list[PlacedBrick] = []
    while top > 0:
        fitting = [h for h in heights if h <= top]
        for height in sorted(fitting, reverse=True):
            cell = Cell.at_level(x, y, top - height, turned=turned)
            brick = heights[height]
            if not any(p in filled for p in occupied_places(cell, brick)):
                column.append(PlacedBrick("", brick, cell))
                top -= height
                break
        else:
            w, d = footprint(Cell(0, 0, 1, turned), next(iter(heights.values())))
            under = ((x + i, y + j, top - 1) for i in range(w) for j in range(d))
            return column if any(place in filled for place in under) else []
    return column
