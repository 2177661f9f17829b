"""Import of LDraw models as bricks on the stud grid.

The x and z axes of LDraw are the x and y axes of the grid; y of LDraw points down. The distance of studs is 20 LDraw
units, the height of a brick 24 units, and that of a plate 8 units. A model may be offset from the grid as a whole,
but all its parts must be on one common grid.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from planning.errors import ScenarioError, format_names
from planning.lego.bricks.assembly import BrickType, Cell
from planning.lego.importers.brick_models.ldraw_files import (
    INHERITED,
    LEVEL,
    STUD,
    Document,
    Reference,
    brick_type_of_file,
    colour_of,
    format_part_table,
    is_baseplate,
    read_document,
)
from planning.lego.importers.brick_models.model import (
    MOST_BRICKS,
    BrickModel,
    FileFaults,
    ModelBrick,
    finish_model,
    read_lines,
)
from planning.transforms import Array

_ROUND = 0.01
"""Error of directions that programs leave behind."""

_OFF = 0.5
"""How far a part may be from the grid of the others, a fifth of a millimetre [LDraw units]."""

_DEEPEST = 50
"""Models within models."""

_MOST_REFERENCES = 4 * MOST_BRICKS
"""Parts and models that are looked at."""


def read_ldraw(path: Path) -> BrickModel:
    """Read a model of LDraw, ``.ldr`` or ``.mpd``, moved to the corner of the grid and its plate.

    Raises:
        ScenarioError: lines are no LDraw; parts are no bricks or plates, do not stand upright, or
            are not on one grid, each by its line; or see ``finish_model``.
    """
    document = read_document(path, read_lines(path))
    every = _parts(path, document)
    parts = [part for part in every if not is_baseplate(part.name)]
    if not parts:
        raise ScenarioError(f"{path}: there are no bricks in it (lines of type 1)")
    kinds = _kinds(path, parts)
    # Parts are drawn along x, the types of bricks are given along y.
    turns = [
        quarter % 2 == 0 and kind.studs[0] != kind.studs[1]
        for quarter, kind in zip(_quarters(path, parts), kinds, strict=True)
    ]
    corners = np.array(
        [_corner(*item) for item in zip(parts, kinds, turns, strict=True)]
    )
    cells = _cells(path, parts, corners)
    bricks = [
        ModelBrick(
            kind,
            Cell.at_level(x, y, level, turned=turned),
            part.source,
            None
            if part.colour in INHERITED
            else colour_of(part.colour, document.colours),
        )
        for part, kind, turned, (x, y, level) in zip(
            parts, kinds, turns, cells, strict=True
        )
    ]
    notes = list(_notes(document, parts))
    if len(parts) < len(every):
        notes.append(
            "base plates are left out: the model stands on the plate of its cell"
        )
    return finish_model(path, bricks, notes)


def _parts(path: Path, document: Document) -> list[Reference]:
    """Return the parts of the whole model, submodels resolved."""
    main = next(iter(document.models))
    out: list[Reference] = []
    # Models that are still to be read, the one whose parts come first on top.
    todo = [(Reference(0, np.eye(4), main, "16"), iter(document.models[main]))]
    references = 0
    while todo:
        at, pending = todo[-1]
        item = next(pending, None)
        if item is None:
            todo.pop()
            continue
        references += 1
        if references > _MOST_REFERENCES:
            raise ScenarioError(
                f"{path}: more than {_MOST_REFERENCES} parts and models"
            )
        via = (*at.via, at.line) if at.line else ()
        colour = at.colour if item.colour in INHERITED else item.colour
        part = replace(item, pose=at.pose @ item.pose, colour=colour, via=via)
        model = document.models.get(item.name)
        # Some programs pack the library's parts into the file: those are bricks all the same.
        if model is None or brick_type_of_file(item.name) is not None:
            out.append(part)
        elif len(via) < _DEEPEST:
            todo.append((part, iter(model)))
        else:
            raise ScenarioError(
                f"{path}:{item.line}: models within models, more than {_DEEPEST} deep:"
                f" {item.name!r} may contain itself"
            )
    return out


def _kinds(path: Path, parts: Sequence[Reference]) -> list[BrickType]:
    """Return the brick type of each part."""
    faults, seen, kinds = FileFaults(path), set[tuple[int, str]](), []
    for part in parts:
        kind = brick_type_of_file(part.name)
        if kind is not None:
            kinds.append(kind)
        elif (part.line, part.name) not in seen:
            seen.add((part.line, part.name))
            faults.add(
                part.line, f"{part.name[:60]!r} is no brick or plate that is known here"
            )
    faults.check(choices=format_part_table())
    return kinds


def _quarters(path: Path, parts: Sequence[Reference]) -> list[int]:
    """Return the number of quarter turns about the vertical of each part."""
    faults, quarters = FileFaults(path), []
    for part in parts:
        found = _quarter(part.pose[:3, :3])
        if isinstance(found, str):
            faults.add(part.line, f"{part.words} is {found}; bricks stand upright")
        else:
            quarters.append(found)
    faults.check()
    return quarters


def _quarter(turn: Array) -> int | str:
    """Return a rotation as quarter turns about y, or a description of it where it is none."""
    if not np.allclose(turn @ turn.T, np.eye(3), atol=2 * _ROUND):
        return "scaled or sheared"
    if np.linalg.det(turn) < 0.0:
        return "mirrored"
    up = float(turn[1, 1])
    if up < _ROUND - 1.0:
        return "upside down"
    if abs(up) < _ROUND:
        return "on its side"
    if up < 1.0 - _ROUND:
        return f"tilted by {math.degrees(math.acos(up)):.0f} degrees"
    angle = math.degrees(math.atan2(turn[0, 2], turn[0, 0]))
    quarter = round(angle / 90.0)
    if abs(angle - 90.0 * quarter) > math.degrees(_ROUND):
        return f"turned by {angle:.0f} degrees, no quarter turn"
    return quarter % 4


def _corner(
    part: Reference, kind: BrickType, turned: bool
) -> tuple[float, float, float]:
    """Return the least x and y of a part, and the height of its bottom [LDraw units]."""
    nx, ny = kind.studs[::-1] if turned else kind.studs
    x, down, z = part.pose[:3, 3]
    return x - nx * STUD / 2, z - ny * STUD / 2, -down - kind.height * LEVEL


def _cells(path: Path, parts: Sequence[Reference], corners: Array) -> list[list[int]]:
    """Return stud and level of each corner, on the grid that most of them share.

    Raises:
        ScenarioError: some are not on it; names them, and by how much.
    """
    unit = np.array([STUD, STUD, LEVEL], dtype=np.float64)
    # Every part proposes the grid it is on; equal proposals are tried once.
    rests = np.round(np.mod(corners, unit) / _OFF) * _OFF % unit
    proposals = Counter(map(tuple, rests.tolist()))
    best: tuple[int, Array] | None = None
    for rest, _ in proposals.most_common(50):
        at = corners[(rests == rest).all(axis=1)][0]
        away = _away(corners - at, unit)
        fits = int((np.abs(away) <= _OFF).all(axis=1).sum())
        if best is None or fits > best[0]:
            best = fits, at
        if fits == len(parts):
            break
    assert best is not None
    fits, at = best
    away = _away(corners - at, unit)
    off = np.flatnonzero((np.abs(away) > _OFF).any(axis=1))
    if off.size:
        faults = FileFaults(path)
        for k in off.tolist():
            dx, dz, up = (round(float(v), 2) + 0.0 for v in away[k])
            faults.add(
                parts[k].line,
                f"{parts[k].words} is off the studs of the other bricks by x {dx:g}, y {-up + 0.0:g},"
                f" z {dz:g} of LDraw's units (20 a stud, 8 a plate)",
            )
        faults.check(form=f"{fits} of {len(parts)} parts are on one grid of studs")
    cells: list[list[int]] = np.round((corners - at) / unit).astype(int).tolist()
    return cells


def _away(offset: Array, unit: Array) -> Array:
    """Return the distance of offsets from the nearest points of a grid."""
    away: Array = offset - np.round(offset / unit) * unit
    return away


def _notes(document: Document, parts: Sequence[Reference]) -> Iterator[str]:
    if document.drawn:
        what = "line that draws" if document.drawn == 1 else "lines that draw"
        yield f"{document.drawn} {what} edges and faces (types 2 to 5): left out"
    if document.steps:
        what = "step is" if document.steps == 1 else "steps are"
        yield f"{document.steps} {what} left out: the planner finds the order itself"
    codes = {part.colour for part in parts} - set(INHERITED)
    unknown = sorted(c for c in codes if colour_of(c, document.colours) is None)
    if unknown:
        yield (
            f"bricks of colour {format_names(unknown)}, which is not known here, have that of their type"
        )
