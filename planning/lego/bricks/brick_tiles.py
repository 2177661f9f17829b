"""Spatial index of the bricks on one plate."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator

from planning.lego.bricks.assembly import GridSpan, PlacedBrick

_TILE = 8
"""Edge length of a tile in studs."""

NumberedBrick = tuple[int, PlacedBrick]
"""A brick with a number: 0 for a brick in the stock, otherwise the number of the step that places it."""


class BrickTiles:
    """Spatial index of the bricks on one plate.

    Args:
        bricks: bricks with numbers; several may have the same position, at different times.
    """

    def __init__(self, bricks: Iterable[NumberedBrick]) -> None:
        self._tiles: dict[tuple[int, int], list[NumberedBrick]] = defaultdict(list)
        for item in bricks:
            for tile in _tiles(item[1].span):
                self._tiles[tile].append(item)

    def near(self, span: GridSpan, before: int) -> dict[str, PlacedBrick]:
        """Return the bricks within one stud of a block whose number is below a given one."""
        found = {
            (number, item.name): item
            for tile in _tiles(span)
            for number, item in self._tiles.get(tile, ())
            if number < before and span.near(item.span, levels=1)
        }
        return {name: found[number, name] for number, name in sorted(found)}


def _tiles(span: GridSpan) -> Iterator[tuple[int, int]]:
    """Yield the tiles of a block and of one stud around it."""
    for x in range((span.x0 - 1) // _TILE, (span.x1 + 1) // _TILE + 1):
        for y in range((span.y0 - 1) // _TILE, (span.y1 + 1) // _TILE + 1):
            yield x, y
