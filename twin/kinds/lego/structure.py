"""Scenario sections of finished LEGO structures, and their conversion to bricks.

If a scenario gives a structure instead of steps, the planner finds the steps. A structure may combine text drawings
of layers, text drawings of side views, and lists of bricks.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Literal

from pydantic import Field, model_validator

from planning.lego.bricks.assembly import BRICK_LEVELS, BrickType, Cell, PlacedBrick
from planning.lego.bricks.drawing import (
    Drawing,
    DrawnBrick,
    name_bricks,
    read_elevation,
    read_layer,
)
from twin.document.section import Name, PairOf, Section, TripleOf
from twin.document.validation import unknown_name
from twin.document.yaml_text import KeyPath
from twin.scenario.sections.shapes import Colour

Stud2 = PairOf[Annotated[int, Field(ge=-1000, le=1000)]]
GridCell = TripleOf[Annotated[int, Field(ge=-1000, le=1000)]]
Raised = Annotated[int, Field(ge=0, lt=BRICK_LEVELS)]


class ElevationSection(Section):
    """A side view, every line of which is one layer; its bricks are equally deep.

    Attributes:
        at: stud and layer of the lower left character (the nearest stud in depth).
        along: the direction that runs to the right.
        depth: studs in the other direction.
        drawing: lines from the top layer down; each run of one letter is a brick, '.' is empty.
    """

    at: GridCell
    along: Literal["x", "y"] = "y"
    depth: Annotated[int, Field(ge=1, le=100)] = 2
    drawing: str


class StructureBrickSection(Section):
    """A brick of a structure: its type, and where it goes (as for the stock).

    Attributes:
        brick: its type.
        at: stud of its least x and y (from 0) and layer (1 = on the plate).
        raised: thirds of a brick from the bottom of the layer to the brick's.
        turned: by +90 degrees about z.
        name: unique in the structure; made of its type and place where it is not given.
        colour: red, green and blue for pictures; by default that of its type.
    """

    brick: str
    at: GridCell
    raised: Raised = 0
    turned: bool = False
    name: Name | None = None
    colour: Colour | None = None


class StructureSection(Section):
    """A finished structure.

    Attributes:
        origin: stud of the lower left character of every layer.
        layers: from the plate up, seen from above with x to the right and y upwards; each patch
            of one letter is a brick, '.' is empty.
        elevations: side views.
        bricks: one by one.
    """

    origin: Stud2 | None = None
    layers: tuple[str, ...] = ()
    elevations: tuple[ElevationSection, ...] = ()
    bricks: tuple[StructureBrickSection, ...] = ()

    @model_validator(mode="after")
    def _check_given(self) -> StructureSection:
        if not (self.layers or self.elevations or self.bricks):
            raise ValueError("give 'layers', 'elevations' or 'bricks'")
        if self.layers and self.origin is None:
            raise ValueError(
                "layers need an 'origin': the stud of their lower left corner"
            )
        return self


@dataclass(frozen=True)
class ReadStructure:
    """The bricks of a structure section.

    Attributes:
        bricks: all of them, with names of their own.
        places: for each brick, the path of the value it is in, with its spot in a drawing.
        problems: what is wrong, each with its place.
    """

    bricks: tuple[PlacedBrick, ...]
    places: tuple[KeyPath, ...]
    problems: tuple[tuple[KeyPath, str], ...]


def read_structure(
    section: StructureSection, types: Mapping[str, BrickType]
) -> ReadStructure:
    """Return the bricks of a structure.

    Args:
        section: the scenario section.
        types: brick types by name.
    """
    drawn: list[DrawnBrick] = []
    places: list[KeyPath] = []
    problems: list[tuple[KeyPath, str]] = []
    for path, drawing in _drawings(section, types):
        drawn += drawing.bricks
        places += [(*path, item.spot) for item in drawing.bricks]
        problems += [((*path, spot), message) for spot, message in drawing.problems]
    given: dict[int, tuple[int, str]] = {}
    for i, item in enumerate(section.bricks):
        if item.brick not in types:
            unknown = unknown_name("brick type", item.brick, tuple(types))
            problems.append((("bricks", i, "brick"), unknown))
            continue
        if item.name is not None:
            given[len(drawn)] = i, item.name
        cell = Cell(*item.at, item.turned, item.raised)
        stem = item.name or f"{item.brick}_"
        drawn.append(DrawnBrick(stem, types[item.brick], cell, (0, 0)))
        places.append(("bricks", i, "at"))
    bricks = list(name_bricks(drawn))
    for k, (_, name) in given.items():
        bricks[k] = replace(bricks[k], name=name)
    counts = Counter(item.name for item in bricks)
    for i, name in given.values():
        if counts[name] > 1:
            message = f"another brick is called {name!r} too"
            problems.append((("bricks", i, "name"), message))
    return ReadStructure(tuple(bricks), tuple(places), tuple(problems))


def _drawings(
    section: StructureSection, types: Mapping[str, BrickType]
) -> Iterator[tuple[KeyPath, Drawing]]:
    for k, text in enumerate(section.layers):
        assert section.origin is not None
        if text.strip() or k == len(section.layers) - 1:
            yield ("layers", k), read_layer(text, section.origin, k + 1, types)
    for k, view in enumerate(section.elevations):
        shown = view.drawing, view.at, view.along, view.depth
        yield ("elevations", k, "drawing"), read_elevation(*shown, types)
