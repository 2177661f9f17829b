"""Reading of LEGO structures from text drawings, in which each brick is drawn with a letter.

A layer is drawn as seen from above, with x to the right and y upwards. An elevation is drawn as seen from the side,
with z upwards and x or y to the right; all its bricks have the same number of studs in the direction of view. Each
connected area of one letter is one brick; ``.`` marks an empty stud. The brick type follows from the size of the area.
Plates, which are lower than a brick, cannot be drawn.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from planning.lego.bricks.assembly import BRICK_LEVELS, BrickType, Cell, PlacedBrick

EMPTY = "."
"""Marks a stud without a brick."""

Spot = tuple[int, int]
"""Line and column of a character in a drawing, from 0."""


@dataclass(frozen=True)
class DrawnBrick:
    """A brick of a drawing.

    Attributes:
        letter: with which it is drawn.
        brick: its type.
        cell: where it sits.
        spot: of its first character.
    """

    letter: str
    brick: BrickType
    cell: Cell
    spot: Spot


@dataclass
class Drawing:
    """Bricks and problems found in a drawing.

    Attributes:
        bricks: in the order of the text.
        problems: position and message of each problem, in the order of the text.
    """

    bricks: list[DrawnBrick] = field(default_factory=list)
    problems: list[tuple[Spot, str]] = field(default_factory=list)


def read_layer(
    text: str, origin: tuple[int, int], z: int, types: Mapping[str, BrickType]
) -> Drawing:
    """Read one layer, seen from above.

    Args:
        text: the drawing; its last line is that of the least y, its first column that of the
            least x.
        origin: stud of its lower left character.
        z: layer, 1 on the plate.
        types: brick types by name.
    """
    lines, drawing = _lines(text)
    for letter, patch in _patches(lines):
        first = min(patch)
        rows, columns = zip(*patch, strict=True)
        left, bottom = min(columns), max(rows)
        size = max(columns) + 1 - left, bottom + 1 - min(rows)
        if len(patch) != size[0] * size[1]:
            message = (
                f"the patch of {letter!r} is no rectangle; bricks that touch need different"
                " letters"
            )
            drawing.problems.append((first, message))
            continue
        at = origin[0] + left, origin[1] + len(lines) - 1 - bottom, z
        _add(drawing, letter, at, size, first, types)
    return drawing


def read_elevation(
    text: str,
    origin: tuple[int, int, int],
    along: Literal["x", "y"],
    depth: int,
    types: Mapping[str, BrickType],
) -> Drawing:
    """Read a side view, every line of which is one layer.

    Args:
        text: the drawing; its last line is the lowest layer, its first column that of the least
            x or y.
        origin: stud and layer of its lower left character, the nearest stud in depth.
        along: the direction that runs to the right.
        depth: studs of every brick along the other direction.
        types: brick types by name.
    """
    lines, drawing = _lines(text)
    x, y, z = origin
    for number, line in enumerate(lines):
        layer = z + len(lines) - 1 - number
        for letter, patch in _patches([line]):
            column = min(patch)[1]
            if along == "x":
                at, size = (x + column, y, layer), (len(patch), depth)
            else:
                at, size = (x, y + column, layer), (depth, len(patch))
            _add(drawing, letter, at, size, (number, column), types)
    return drawing


def name_bricks(drawn: Iterable[DrawnBrick]) -> tuple[PlacedBrick, ...]:
    """Return bricks with unique names: letter and layer, numbered where that is not enough."""
    out: list[PlacedBrick] = []
    taken: set[str] = set()
    for item in drawn:
        stem = f"{item.letter}{item.cell.z}"
        name, count = stem, 1
        while name in taken:
            count += 1
            name = f"{stem}_{count}"
        taken.add(name)
        out.append(PlacedBrick(name, item.brick, item.cell))
    return tuple(out)


def type_of_size(
    size: tuple[int, int], types: Mapping[str, BrickType]
) -> tuple[BrickType, bool] | str:
    """Return the brick type of a size along x and y and whether it is turned, or the reason why there is none.

    Square bricks are not turned.
    """
    nx, ny = size
    bricks = [t for t in types.values() if t.height == BRICK_LEVELS and not t.bare]
    found = [t for t in bricks if tuple(sorted(t.studs)) == tuple(sorted(size))]
    if not found:
        sizes = {tuple(sorted(t.studs)) for t in bricks}
        known = ", ".join(f"{a} x {b}" for a, b in sorted(sizes))
        return f"no brick type has {nx} x {ny} studs (there are {known})"
    if len(found) > 1:
        names = ", ".join(sorted(t.name for t in found))
        return f"several brick types have {nx} x {ny} studs ({names}): give it under 'bricks'"
    return found[0], found[0].studs != size


def _lines(text: str) -> tuple[list[str], Drawing]:
    """Return the lines without empty ones at the end, and a drawing with their problems."""
    drawing = Drawing()
    lines = [line.rstrip() for line in text.splitlines()]
    while lines and not lines[-1]:
        lines.pop()
    if not lines:
        drawing.problems.append(((0, 0), "the drawing is empty"))
    for row, line in enumerate(lines):
        if len(line) != len(lines[0]):
            message = (
                f"this line has {len(line)} characters, the first line of the drawing "
                f"{len(lines[0])}"
            )
            drawing.problems.append(((row, 0), message))
        for column, letter in enumerate(line):
            if letter != EMPTY and not (letter.isascii() and letter.isalnum()):
                message = (
                    f"{letter!r} is neither a letter or digit nor '.' for an empty stud"
                )
                drawing.problems.append(((row, column), message))
    return ([] if drawing.problems else lines), drawing


def _patches(lines: Sequence[str]) -> list[tuple[str, set[Spot]]]:
    """Return the connected patches of each letter, by their first characters."""
    places = {(i, j): c for i, line in enumerate(lines) for j, c in enumerate(line)}
    seen: set[Spot] = set()
    out = []
    for start, letter in places.items():
        if letter == EMPTY or start in seen:
            continue
        patch, todo = {start}, [start]
        while todo:
            i, j = todo.pop()
            around = {(i + 1, j), (i - 1, j), (i, j + 1), (i, j - 1)}
            new = {spot for spot in around - patch if places.get(spot) == letter}
            patch |= new
            todo += new
        seen |= patch
        out.append((letter, patch))
    return out


def _add(
    drawing: Drawing,
    letter: str,
    at: tuple[int, int, int],
    size: tuple[int, int],
    spot: Spot,
    types: Mapping[str, BrickType],
) -> None:
    found = type_of_size(size, types)
    if isinstance(found, str):
        drawing.problems.append((spot, f"{letter!r}: {found}"))
        return
    kind, turned = found
    drawing.bricks.append(DrawnBrick(letter, kind, Cell(*at, turned), spot))
