"""Bricks by tiles of the grid, so that the neighbours of one are found without looking at all."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator

from planning.lego.bricks.assembly import BrickType, Cell
from planning.lego.bricks.grid import Span, occupied_span

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
        self._tiles: dict[tuple[int, int], list[tuple[Span, Numbered]]] = defaultdict(
            list
        )
        for item in bricks:
            span = occupied_span(item[2], item[3])
            for tile in _tiles(span):
                self._tiles[tile].append((span, item))

    def near(self, span: Span, before: int) -> dict[str, tuple[Cell, BrickType]]:
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


def _tiles(span: Span) -> Iterator[tuple[int, int]]:
    """Yield the tiles of some room and of a stud beside it."""
    for x in range((span.x0 - 1) // _TILE, (span.x1 + 1) // _TILE + 1):
        for y in range((span.y0 - 1) // _TILE, (span.y1 + 1) // _TILE + 1):
            yield x, y
