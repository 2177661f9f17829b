"""Colours of fixtures."""

from __future__ import annotations

from collections.abc import Iterator

from planning.cell.workcell import Fixture, Workcell

_GREYS = ((178, 170, 158), (196, 201, 207), (140, 146, 154))


def coloured_fixtures(
    cell: Workcell,
) -> Iterator[tuple[Fixture, tuple[int, int, int]]]:
    """Yield the fixtures of a cell with their colours, 0 to 255: their own, or greys."""
    ground, *others = _GREYS
    for k, fixture in enumerate(cell.fixtures):
        # The first one, mostly the table, is told apart from all that stand on it.
        grey = ground if k == 0 else others[(k - 1) % len(others)]
        yield fixture, fixture.colour or grey
