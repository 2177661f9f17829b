"""Structures as drawings: what is read, what is refused, and the way back."""

from collections.abc import Sequence

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.lego.bricks.assembly import BrickType, Cell, PlacedBrick
from planning.lego.bricks.brick_types import BRICKS
from planning.lego.bricks.drawing import (
    EMPTY,
    Drawing,
    name_bricks,
    read_elevation,
    read_layer,
    type_of_size,
)
from tests.planning.lego.structures import scattered


def cells(drawing: Drawing) -> set[tuple[str, str, Cell]]:
    assert drawing.problems == []
    return {(b.letter, b.brick.name, b.cell) for b in drawing.bricks}


def test_a_layer_is_seen_from_above() -> None:
    """The last line is the least y; a brick that is longer along x is turned."""
    drawing = read_layer("BBBB..\nBBBBAA\n....AA\n", (10, 20), 3, BRICKS)
    assert cells(drawing) == {
        ("B", "2x4", Cell(10, 21, 3, turned=True)),
        ("A", "2x2", Cell(14, 20, 3)),
    }


def test_patches_of_one_letter_that_do_not_touch_are_bricks_of_their_own() -> None:
    drawing = read_layer("AA.AA\nAA.AA", (0, 0), 1, BRICKS)
    assert [b.cell.x for b in drawing.bricks] == [0, 3]
    assert [b.name for b in name_bricks(drawing.bricks)] == ["A1", "A1_2"]


def test_an_elevation_has_a_layer_a_line() -> None:
    """Equal letters above each other are different bricks."""
    drawing = read_elevation("AAAA..\n..AAAA", (23, 14, 5), "y", 2, BRICKS)
    assert cells(drawing) == {
        ("A", "2x4", Cell(23, 14, 6)),
        ("A", "2x4", Cell(23, 16, 5)),
    }


def test_an_elevation_along_x_turns_its_bricks() -> None:
    drawing = read_elevation("AAAAAA", (4, 5, 1), "x", 2, BRICKS)
    assert cells(drawing) == {("A", "2x6", Cell(4, 5, 1, turned=True))}


@pytest.mark.parametrize(
    ("text", "spot", "message"),
    [
        ("AA\nA.", (0, 0), "'A' is no rectangle"),
        ("....\n.AAA\n.AAA\n.AAA\n.AAA\n.AAA", (1, 1), "no brick type has 3 x 5 studs"),
        ("A-\n..", (0, 1), "'-' is neither a letter"),
        ("AAAA\nAAA", (1, 0), "this line has 3 characters"),
        ("\n", (0, 0), "empty"),
    ],
)
def test_what_is_no_brick_is_told_with_its_place(
    text: str, spot: tuple[int, int], message: str
) -> None:
    drawing = read_layer(text, (0, 0), 1, BRICKS)
    ((where, what),) = drawing.problems
    assert where == spot
    assert message in what


def test_a_size_that_two_types_have_needs_a_list() -> None:
    types = {**BRICKS, "red": BrickType("red", (4, 2), 0.002)}
    assert "2x4, red" in str(type_of_size((2, 4), types))
    assert type_of_size((2, 6), types) == (BRICKS["2x6"], False)
    assert type_of_size((6, 2), types) == (BRICKS["2x6"], True)


WHOLE = {name: kind for name, kind in BRICKS.items() if kind.height == 3}


LAYERS = st.integers(0, 2).map(lambda layer: 3 * layer)
STRUCTURES = scattered(WHOLE, 12, (-3, 9), LAYERS)


def draw_layers(
    bricks: Sequence[PlacedBrick],
) -> tuple[tuple[int, int], tuple[str, ...]]:
    """Return the drawing of a structure: the inverse of ``read_layer``.

    Args:
        bricks: of the structure; none may overlap.

    Returns:
        Stud of the lower left character, and the layers from the first one up.
    """
    if not bricks:
        return (0, 0), ()
    spans = [item.span for item in bricks]
    left, right = min(s.x0 for s in spans), max(s.x1 for s in spans)
    low, high = min(s.y0 for s in spans), max(s.y1 for s in spans)
    top = max(item.cell.z for item in bricks)
    layers = []
    for z in range(1, top + 1):
        grid = [[EMPTY] * (right - left) for _ in range(high - low)]
        here = [item.span for item in bricks if item.cell.z == z]
        for span in sorted(here, key=lambda s: (-s.y1, s.x0)):
            rows = range(high - span.y1, high - span.y0)
            columns = range(span.x0 - left, span.x1 - left)
            letter = _free_letter(grid, rows, columns)
            for row in rows:
                grid[row][columns.start : columns.stop] = letter * len(columns)
        layers.append("".join("".join(row) + "\n" for row in grid))
    return (left, low), tuple(layers)


def _free_letter(grid: Sequence[Sequence[str]], rows: range, columns: range) -> str:
    """Return the first letter that no character beside a rectangle has."""
    beside = {(i, j) for i in rows for j in (columns.start - 1, columns.stop)}
    beside |= {(i, j) for j in columns for i in (rows.start - 1, rows.stop)}
    taken = {
        grid[i][j] for i, j in beside if 0 <= i < len(grid) and 0 <= j < len(grid[0])
    }
    return next(
        c
        for c in "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz"
        if c not in taken
    )


@settings(max_examples=150, deadline=None)
@given(STRUCTURES)
def test_what_is_drawn_is_read_back(structure: list[PlacedBrick]) -> None:
    origin, layers = draw_layers(structure)
    back = []
    for z, text in enumerate(layers, start=1):
        if set(text) <= {".", "\n"}:
            continue
        drawing = read_layer(text, origin, z, BRICKS)
        assert drawing.problems == []
        back += [(b.cell, b.brick.name) for b in drawing.bricks]
    assert sorted(back, key=str) == sorted(
        ((b.cell, b.brick.name) for b in structure), key=str
    )
