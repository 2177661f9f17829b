"""A brick model from a file of another program: bricks on the stud grid, each with its line number in the file."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import networkx as nx
import numpy as np

from planning.errors import ScenarioError, format_faults, format_names
from planning.files import LARGEST, read_file
from planning.lego.bricks.assembly import BrickType, Cell, GridPlace, GridSpan, OnGrid
from planning.lego.bricks.grid import bricks_joined_to_plate

MOST_BRICKS = 20_000
"""Greatest number of bricks in a model."""

_TOUCH = 0.05
"""How far boxes may be in each other before they overlap [studs or levels]."""

_LEAST = 10
"""Of so many bricks of a partial model one at least is joined to the plate below its lowest brick."""

_MOST_NAMES = 200
"""Bricks of a note that are named."""

_REASONABLE = 100_000
"""Greatest extent of a model; a larger one is taken for an error in the file [studs or levels]."""


@dataclass(frozen=True)
class ModelBrick(OnGrid):
    """A brick of a model.

    Attributes:
        brick: its type.
        cell: where it is; the least x, y and level of a whole model are 0.
        source: where it stands in the file, such as ``"line 12"``.
        colour: red, green and blue, None where the file gives none.
    """

    brick: BrickType
    cell: Cell
    source: str
    colour: tuple[int, int, int] | None = None

    @property
    def words(self) -> str:
        """Source and type, such as ``"line 12 (2x4)"``."""
        return f"{self.source} ({self.brick.name})"


@dataclass(frozen=True)
class Obstacle:
    """A part of a model that no tool places: a box that stands at its place from the start.

    Attributes:
        name: of its part.
        source: where it stands in the file.
        low, high: corners of the box: studs along x and y, and level.
    """

    name: str
    source: str
    low: tuple[float, float, float]
    high: tuple[float, float, float]

    @property
    def words(self) -> str:
        """Source and part, such as ``"line 12 (3039.dat)"``."""
        return f"{self.source} ({self.name})"

    @property
    def places(self) -> tuple[GridPlace, GridPlace]:
        """First places of the grid that it fills, also in part, along each axis, and those behind the last ones."""
        x0, y0, z0 = (math.floor(v + _TOUCH) for v in self.low)
        x1, y1, z1 = (math.ceil(v - _TOUCH) for v in self.high)
        return (x0, y0, z0), (x1, y1, z1)

    def moved(self, x: float, y: float, level: float) -> Obstacle:
        """Return the obstacle moved by studs and levels, without what is below the plate then."""
        low = self.low[0] + x, self.low[1] + y, max(self.low[2] + level, 0.0)
        high = self.high[0] + x, self.high[1] + y, self.high[2] + level
        return replace(self, low=low, high=high)


@dataclass(frozen=True)
class BrickModel:
    """A brick model, moved to the corner of the grid and down to its plate, with notes on what was not imported."""

    bricks: tuple[ModelBrick, ...]
    notes: tuple[str, ...] = ()
    obstacles: tuple[Obstacle, ...] = ()

    @property
    def size(self) -> tuple[int, int, int]:
        """Studs along x and y, and levels."""
        ends = [(i.span.x1, i.span.y1, i.span.top) for i in self.bricks]
        boxes = [item.places[1] for item in self.obstacles]
        x, y, top = map(max, zip(*ends, *boxes, strict=True))
        return x, y, top

    @property
    def studs(self) -> frozenset[tuple[int, int]]:
        """The (x, y) of every stud that is covered, by obstacles also in part."""
        spans = [item.span for item in self.bricks]
        for item in self.obstacles:
            (x0, y0, _), (x1, y1, _) = item.places
            spans.append(GridSpan(x0, x1, y0, y1, 0, 1))
        return frozenset().union(*(span.studs for span in spans))

    def quarter_turned(self) -> BrickModel:
        """Return the model turned by +90 degrees about the vertical."""
        deep = self.size[1]
        bricks = []
        for item in self.bricks:
            span = item.span
            turned = not item.cell.turned and item.brick.studs[0] != item.brick.studs[1]
            cell = replace(item.cell, x=deep - span.y1, y=span.x0, turned=turned)
            bricks.append(replace(item, cell=cell))
        obstacles = []
        for box in self.obstacles:
            (x0, y0, bottom), (x1, y1, top) = box.low, box.high
            low, high = (deep - y1, x0, bottom), (deep - y0, x1, top)
            obstacles.append(replace(box, low=low, high=high))
        return replace(self, bricks=tuple(bricks), obstacles=tuple(obstacles))

    @property
    def kinds(self) -> Counter[BrickType]:
        """Number of bricks of each type."""
        return Counter(item.brick for item in self.bricks)


def check_faults(
    path: Path,
    faults: Collection[tuple[int, str]],
    form: str,
    choices: Sequence[str] = (),
) -> None:
    """Raise a ScenarioError where lines have faults: the first by line, how many more, and the expected form."""
    if faults:
        lines = [f"{path}:{at}: {words}" for at, words in sorted(faults)]
        raise ScenarioError(f"{format_faults(lines)}\n{form}", choices=tuple(choices))


def read_lines(path: Path, most: int = LARGEST) -> list[str]:
    """Return the lines of a text file of any usual encoding, without line ends; it has a greatest size [bytes].

    Raises:
        ScenarioError: it cannot be read, or is no text.
    """
    try:
        content = read_file(path, most)
    except IsADirectoryError:
        raise ScenarioError(f"{path}: this is a folder, a file is expected") from None
    except OSError as error:
        reason = error.strerror or str(error)
        raise ScenarioError(f"{path}: cannot be read: {reason}") from None
    if content.startswith(b"PK\x03\x04"):
        words = (
            "this is an archive, such as Studio's .io: export the model as LDraw there"
        )
        raise ScenarioError(f"{path}: {words}")
    wide = content.startswith((b"\xff\xfe", b"\xfe\xff"))
    try:
        text = content.decode("utf-16" if wide else "utf-8-sig")
    except UnicodeDecodeError:
        # Windows programs write names in their own code page.
        text = content.decode("utf-16" if wide else "cp1252", errors="replace")
    if "\x00" in text:
        raise ScenarioError(f"{path}: this is no text file")
    return text.replace("\r\n", "\n").replace("\r", "\n").split("\n")


def finish_model(
    path: Path, bricks: Sequence[ModelBrick], notes: Iterable[str] = ()
) -> BrickModel:
    """Return a model of bricks from any position on the grid, moved to its corner.

    Raises:
        ScenarioError: there are no bricks or too many, two are in one place, or some are
            joined to nothing that stands on the plate; names them.
    """
    _check_size(path, bricks)
    if overlaps := _overlaps(bricks):
        pairs = [f"{bricks[a].words} and {bricks[b].words}" for b, a in overlaps]
        raise ScenarioError(f"{path}: in one place: {format_names(pairs)}")
    held = _held(bricks)
    if loose := [item.words for k, item in enumerate(bricks) if k not in held]:
        words = "joined to nothing that stands where the lowest brick stands"
        raise ScenarioError(f"{path}: {words}: {format_names(loose)}")
    return _moved(bricks, (), tuple(notes))


def finish_partial_model(
    path: Path,
    bricks: Sequence[ModelBrick],
    obstacles: Sequence[Obstacle],
    notes: Iterable[str] = (),
) -> BrickModel:
    """Return a model without what cannot be built, all of it named in notes.

    Obstacles on bricks cannot stand from the start: they are left out, and so are those within
    bricks, and what they have below the plate. Bricks are left out that are where an obstacle or a
    brick before them is, and those that nothing joins then to the plate, on which the lowest stands;
    where that holds few of the bricks, the lowest of the largest group of joined bricks.

    Raises:
        ScenarioError: there are no bricks left, or too many.
    """
    _check_size(path, bricks, obstacles)
    taken = frozenset().union(*(item.places for item in bricks))
    spans = np.array([item.span for item in bricks], dtype=np.float64)
    low, high = spans[:, 0::2], spans[:, 1::2]
    outer, hidden = list[Obstacle](), set[int]()
    above, within = list[str](), list[str]()
    for thing in obstacles:
        least, most = np.array(thing.low) + _TOUCH, np.array(thing.high) - _TOUCH
        beside = ((low < most) & (least < high))[:, :2].all(axis=1)
        inside = beside & (low[:, 2] < most[2]) & (least[2] < high[:, 2])
        if _is_filled(thing, taken):
            within.append(thing.words)
        elif (beside & (high[:, 2] <= least[2])).any():
            above.append(thing.words)
        else:
            outer.append(thing)
            hidden.update(np.flatnonzero(inside).tolist())
    notes = [
        *notes,
        *_left_out("within bricks", within),
        *_left_out("on bricks, which come first", above),
        *_left_out("where a box stands", [bricks[k].words for k in sorted(hidden)]),
    ]
    free = [item for k, item in enumerate(bricks) if k not in hidden]
    second = {b for b, _ in _overlaps(free)}
    notes += _left_out("where another is", [free[k].words for k in sorted(second)])
    free = [item for k, item in enumerate(free) if k not in second]
    if not free:
        raise ScenarioError(f"{path}: no brick is left that could be placed")
    held = _held(free)
    if len(held) * _LEAST < len(free):
        # A small thing below the others: rather the largest group stands on the plate.
        lowest = min(free[k].span.bottom for k in _largest_group(free))
        below = [item.words for item in free if item.span.bottom < lowest]
        notes += _left_out("below the largest group of joined bricks", below)
        free = [item for item in free if item.span.bottom >= lowest]
        held = _held(free)
    loose = [item.words for k, item in enumerate(free) if k not in held]
    notes += _left_out("joined to nothing that stands on the plate", loose)
    return _moved([free[k] for k in sorted(held)], outer, tuple(notes))


def _is_filled(box: Obstacle, places: Collection[GridPlace]) -> bool:
    """Tell whether a box is only where there are bricks, given the places that they fill."""
    return all(place in places for place in product(*map(range, *box.places)))


def _check_size(
    path: Path, bricks: Sequence[ModelBrick], obstacles: Sequence[Obstacle] = ()
) -> None:
    if not bricks:
        raise ScenarioError(f"{path}: there are no bricks in it")
    if len(bricks) + len(obstacles) > MOST_BRICKS:
        raise ScenarioError(f"{path}: more than {MOST_BRICKS} bricks")
    spans = [item.span for item in bricks]
    lows = [(s.x0, s.y0, s.bottom) for s in spans] + [i.low for i in obstacles]
    highs = [(s.x1, s.y1, s.top) for s in spans] + [i.high for i in obstacles]
    if np.ptp(np.array([*lows, *highs], dtype=np.float64), axis=0).max() > _REASONABLE:
        words = f"the bricks are more than {_REASONABLE} studs apart"
        raise ScenarioError(f"{path}: {words}")


def _moved(
    bricks: Sequence[ModelBrick], obstacles: Sequence[Obstacle], notes: tuple[str, ...]
) -> BrickModel:
    """Return a model with its least stud and the level of its lowest brick at 0."""
    spans = [item.span for item in bricks]
    level = min(s.bottom for s in spans)
    left = [i for i in obstacles if i.high[2] - _TOUCH > level]
    x0 = min([s.x0 for s in spans] + [i.places[0][0] for i in left])
    y0 = min([s.y0 for s in spans] + [i.places[0][1] for i in left])
    moved = []
    for item, span in zip(bricks, spans, strict=True):
        at = span.x0 - x0, span.y0 - y0, span.bottom - level
        cell = Cell.at_level(*at, turned=item.cell.turned)
        moved.append(replace(item, cell=cell))
    below = [item.words for item in obstacles if item not in left]
    notes += tuple(_left_out("below the plate", below))
    boxes = tuple(item.moved(-x0, -y0, -level) for item in left)
    return BrickModel(tuple(moved), notes, boxes)


def _left_out(why: str, things: Sequence[str]) -> list[str]:
    """Return the note of what is left out, if there is anything."""
    names = format_names(things, _MOST_NAMES)
    return [f"{len(things)} left out, {why}: {names}"] if things else []


def _overlaps(bricks: Sequence[ModelBrick]) -> list[tuple[int, int]]:
    """Return the bricks that are where another is, each with one before it that is there."""
    taken: dict[GridPlace, int] = {}
    found: dict[tuple[int, int], None] = {}
    for k, item in enumerate(bricks):
        for place in sorted(item.places):
            other = taken.setdefault(place, k)
            if other != k:
                found.setdefault((k, other))
    return list(found)


def _largest_group(bricks: Sequence[ModelBrick]) -> set[int]:
    """Return the largest group of bricks that are joined to each other."""
    owner = {place: k for k, item in enumerate(bricks) for place in item.places}
    graph: nx.Graph[int] = nx.Graph()
    graph.add_nodes_from(range(len(bricks)))
    above = ((k, owner.get((x, y, z + 1))) for (x, y, z), k in owner.items())
    graph.add_edges_from((k, other) for k, other in above if other is not None)
    return max(nx.connected_components(graph), key=len)


def _held(bricks: Sequence[ModelBrick]) -> set[int]:
    """Return the bricks that are joined to a plate below the lowest of them."""
    level = min(item.span.bottom for item in bricks)
    places = {
        k: frozenset((x, y, z - level) for x, y, z in item.places)
        for k, item in enumerate(bricks)
    }
    return bricks_joined_to_plate(places)
