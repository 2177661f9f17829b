"""Import of LDraw models as bricks on the stud grid.

The x and z axes of LDraw are the x and y axes of the grid; y of LDraw points down. The distance of studs is 20 LDraw
units, the height of a brick 24 units, and that of a plate 8 units. A model may be offset from the grid as a whole,
but all its parts must be on one common grid.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np

from planning.errors import ScenarioError, format_names
from planning.lego.bricks.assembly import Cell
from planning.lego.importers.brick_models.ldraw_files import (
    INHERITED,
    Colour,
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
    ModelBrick,
    Obstacle,
    check_faults,
    finish_model,
    finish_partial_model,
    read_lines,
)
from planning.lego.importers.brick_models.part_library import PartLibrary
from planning.lego.importers.brick_models.part_shape import LEVEL, STUD, PartShape
from planning.transforms import Array

_ROUND = 0.01
"""Error of directions that programs leave behind."""

_OFF = 0.5
"""How far a part may be from the grid of the others, a fifth of a millimetre [LDraw units]."""

_UNIT = np.array([STUD, STUD, LEVEL], dtype=np.float64)

_MOST_FRAMES = 3
"""Rotations that are tried as the one of the whole model."""

_MOST_NAMES = 200
"""Files of parts that are listed."""

_DEEPEST = 50
"""Models within models."""

_MOST_REFERENCES = 4 * MOST_BRICKS
"""Parts and models that are looked at."""

_LARGEST_BOX = 400
"""Greatest extent of an obstacle [studs or levels]."""

Unknown = Literal["refuse", "box", "leave-out"]
"""What becomes of parts that are not placed as bricks."""

Fault = tuple[Reference, str]
"""A part, and what is wrong with it."""


def read_ldraw(
    path: Path, *, library: Path | None = None, unknown: Unknown = "refuse"
) -> BrickModel:
    """Read a model of LDraw, ``.ldr`` or ``.mpd``, moved to the corner of the grid and its plate.

    Args:
        path: the model.
        library: folder of a parts library, with ``parts`` and ``p``.
        unknown: what becomes of parts that are no bricks, do not stand upright, or are not on the
            grid of the others: they are refused, obstacles of their size, or left out; in the last
            two cases also the bricks that nothing else holds are left out.

    Raises:
        ScenarioError: lines are no LDraw; the library is none; parts are no bricks or plates, do
            not stand upright, or are not on one grid, each by its line; an obstacle has no size;
            or see ``finish_model``.
    """
    document = read_document(path, read_lines(path))
    source = PartLibrary(library, path, document.parts)
    document.colours = {**source.colours(), **document.colours}
    every = _parts(path, document)
    parts = [part for part in every if not is_baseplate(part.name)]
    if not parts:
        raise ScenarioError(f"{path}: there are no bricks in it (lines of type 1)")
    found = {part.name: source.shape(part.name) for part in parts}
    shapes = {k: own for k, own in found.items() if isinstance(own, PartShape)}
    reasons = {k: own for k, own in found.items() if isinstance(own, str)}
    reasons |= {k: own.reason for k, own in shapes.items() if own.reason}
    frame = _frame([part for part in parts if part.name not in reasons])
    parts = [replace(part, pose=frame.T @ part.pose) for part in parts]
    unfit = [
        (part, f"{part.name[:60]!r} is no brick or plate: {reasons[part.name]}")
        for part in parts
        if part.name in reasons
    ]
    if unknown == "refuse":
        _refuse_unknown(path, unfit, with_library=library is not None)
    upright = [part for part in parts if part.name not in reasons]
    tilts = [_tilt(part) for part in upright]
    tilted = [own for own in zip(upright, tilts, strict=True) if own[1]]
    if len(tilted) == len(upright) or unknown == "refuse":
        _check(path, tilted or unfit, "no part of the model stands as a brick")
    placed = [p for p, tilt in zip(upright, tilts, strict=True) if not tilt]
    boxes = np.array([_box(part, shapes[part.name]) for part in placed])
    origin, away = _grid(boxes[:, 0])
    gaps = [_distance(part, own) for part, own in zip(placed, away, strict=True)]
    off = [own for own in zip(placed, gaps, strict=True) if own[1]]
    fits = len(placed) - len(off)
    if unknown == "refuse":
        _check(path, off, f"{fits} of {len(placed)} parts are on one grid of studs")
    bricks = [
        _brick(part, shapes[part.name], (box - origin) / _UNIT, document.colours)
        for part, box, gap in zip(placed, boxes, gaps, strict=True)
        if not gap
    ]
    notes = list(_notes(document, placed))
    if not np.array_equal(frame, np.eye(4)):
        notes.append("the model stands upright, not turned as in its file")
    if len(parts) < len(every):
        what = "base plates are left out: the model stands on the plate of its cell"
        notes.append(what)
    if unknown == "refuse":
        return finish_model(path, bricks, notes)
    others = [part for part, _ in (*unfit, *tilted, *off)]
    how = "left out" if unknown == "leave-out" else "boxes from the start"
    if unfit:
        notes.append(f"no bricks, {how}: {_counted([part for part, _ in unfit])}")
    if askew := [f"{p.source} ({p.name})" for p, _ in (*tilted, *off)]:
        what = f"not upright or off the grid, {how}"
        notes.append(f"{what}: {format_names(askew, _MOST_NAMES)}")
    obstacles = _obstacles(path, others, found, origin) if unknown == "box" else ()
    return finish_partial_model(path, bricks, obstacles, notes)


def _refuse_unknown(path: Path, faults: Sequence[Fault], *, with_library: bool) -> None:
    """Raise the error of parts that are no bricks, with their numbers and what can be done."""
    first = {part.name: (part.line, fault) for part, fault in reversed(faults)}
    library = "" if with_library else "--parts DIR reads sizes from a parts library; "
    form = (
        f"{len(faults)} parts: {_counted([part for part, _ in faults])}\n{library}"
        "--unknown box lets boxes stand in their places from the start,"
        " --unknown leave-out leaves them out, and what only they hold"
    )
    check_faults(path, first.values(), form, format_part_table())


def _counted(parts: Sequence[Reference]) -> str:
    """Return the files of parts with their numbers, such as ``"3039.dat (12), 3062b.dat (1)"``."""
    counts = Counter(part.name[:60] for part in parts).most_common()
    return format_names([f"{name} ({n})" for name, n in counts], _MOST_NAMES)


def _check(path: Path, faults: Sequence[Fault], form: str) -> None:
    """Raise an error where parts have faults."""
    check_faults(path, [(part.line, fault) for part, fault in faults], form)


def _obstacles(
    path: Path,
    parts: Sequence[Reference],
    shapes: Mapping[str, PartShape | str],
    origin: Array,
) -> list[Obstacle]:
    """Return the boxes of parts that are not placed, in studs and levels of a grid."""
    faults, out = list[Fault](), list[Obstacle]()
    for part in parts:
        shape = shapes[part.name]
        if isinstance(shape, str):
            faults.append((part, f"{part.name[:60]!r} has no size for a box: {shape}"))
            continue
        low, high = (_box(part, shape) - origin) / _UNIT
        if (high - low).max() > _LARGEST_BOX:
            what = f"{part.words} is larger than {_LARGEST_BOX} studs"
            faults.append((part, what))
        ends = tuple(low.tolist()), tuple(high.tolist())
        out.append(Obstacle(part.name, part.source, *ends))
    _check(path, faults, "--parts DIR gives sizes; --unknown leave-out takes none")
    return out


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
            most = f"more than {_MOST_REFERENCES} parts and models"
            raise ScenarioError(f"{path}: {most}")
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


def _frame(parts: Sequence[Reference]) -> Array:
    """Return the rotation that bricks have in common, shape (4, 4), where most do not stand upright without it.

    Showpieces are turned as a whole. A single brick is as its file says.
    """
    frame, turns = np.eye(4), [part.pose[:3, :3] for part in parts]
    most = max(sum(_is_upright(turn) for turn in turns), len(turns) // 2, 1)
    common = Counter(tuple(np.round(turn, 3).ravel().tolist()) for turn in turns)
    for rounded, _ in common.most_common(_MOST_FRAMES):
        turn = next(t for t in turns if np.allclose(t.ravel(), rounded, atol=_ROUND))
        if np.allclose(turn @ turn.T, np.eye(3), atol=_ROUND):
            count = sum(_is_upright(turn.T @ other) for other in turns)
            if count > most:
                most, frame[:3, :3] = count, turn
    return frame


def _is_upright(turn: Array) -> bool:
    return not _misturn(turn)


def _tilt(part: Reference) -> str:
    """Return how a part does not stand upright; nothing where it does."""
    found = _misturn(part.pose[:3, :3])
    return found and f"{part.words} is {found}; bricks stand upright"


def _misturn(turn: Array) -> str:
    """Return how a rotation is other than by quarter turns about y; nothing where it is not."""
    if not np.allclose(turn @ turn.T, np.eye(3), atol=2 * _ROUND):
        return "scaled or sheared"
    up = float(turn[1, 1])
    if up < _ROUND - 1.0:
        return "upside down"
    if abs(up) < _ROUND:
        return "on its side"
    if up < 1.0 - _ROUND:
        return f"tilted by {math.degrees(math.acos(up)):.0f} degrees"
    angle = math.degrees(math.atan2(turn[0, 2], turn[0, 0]))
    if abs(angle - 90.0 * round(angle / 90.0)) > math.degrees(_ROUND):
        return f"turned by {angle:.0f} degrees, no quarter turn"
    return ""


def _box(part: Reference, shape: PartShape) -> Array:
    """Return the least and the greatest x, y and height of a part, shape (2, 3) [LDraw units]."""
    low, high = shape.placed(part.pose)
    return np.array([[low[0], low[2], -high[1]], [high[0], high[2], -low[1]]])


def _brick(
    part: Reference, shape: PartShape, box: Array, colours: Mapping[int, Colour]
) -> ModelBrick:
    """Return a part as a brick, given its box in studs and levels."""
    low = np.round(box[0]).astype(int).tolist()
    kind, turned = shape.brick(part.pose)
    colour = None if part.colour in INHERITED else colour_of(part.colour, colours)
    cell = Cell.at_level(*low, turned=turned)
    return ModelBrick(kind, cell, part.source, colour)


def _grid(corners: Array) -> tuple[Array, Array]:
    """Return the grid that most corners are on, as one of its points, and their distances from it."""
    # Every part proposes the grid it is on; equal proposals are tried once.
    rests = np.round(np.mod(corners, _UNIT) / _OFF) * _OFF % _UNIT
    proposals = Counter(map(tuple, rests.tolist()))
    points = [
        corners[(rests == rest).all(axis=1)][0] for rest, _ in proposals.most_common(50)
    ]
    on_grid = [np.abs(_away(corners - at)) <= _OFF for at in points]
    best = points[int(np.argmax([own.all(axis=1).sum() for own in on_grid]))]
    return best, _away(corners - best)


def _distance(part: Reference, away: Array) -> str:
    """Return how far a part is from the grid; nothing where it is on it."""
    if (np.abs(away) <= _OFF).all():
        return ""
    dx, dz, up = (round(float(v), 2) + 0.0 for v in away)
    return (
        f"{part.words} is off the studs of the other bricks by x {dx:g}, y {-up + 0.0:g},"
        f" z {dz:g} of LDraw's units (20 a stud, 8 a plate)"
    )


def _away(offset: Array) -> Array:
    """Return the distance of offsets from the nearest points of the grid."""
    return np.asarray(offset - np.round(offset / _UNIT) * _UNIT)


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
