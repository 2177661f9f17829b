"""Bricks found by tiles are those that a look at all of them finds."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from planning.lego.bricks.assembly import BRICKS, Cell
from planning.lego.bricks.grid import BrickTiles, occupied_span

bricks = st.tuples(
    st.integers(0, 3),
    st.builds(
        Cell, st.integers(-9, 30), st.integers(-9, 30), st.integers(1, 4), st.booleans()
    ),
    st.sampled_from(["1x1", "1x8", "2x4"]),
)


@given(st.lists(bricks, max_size=40), bricks, st.integers(0, 4))
def test_tiles_find_all_neighbours_in_their_order(items, one, before):
    numbered = [
        (number, f"b{k}", cell, BRICKS[kind])
        for k, (number, cell, kind) in enumerate(items)
    ]
    span = occupied_span(one[1], BRICKS[one[2]])
    near = [
        item
        for item in sorted(numbered, key=lambda item: item[:2])
        if item[0] < before and span.near(occupied_span(*item[2:]), levels=1)
    ]
    found = BrickTiles(numbered).near(span, before)
    assert list(found.items()) == [(name, (cell, kind)) for _, name, cell, kind in near]
