"""Checks of a drawn structure: bricks that exist, in a place of their own, not in the air."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping

from planning.lego.bricks.assembly import BrickType
from planning.lego.bricks.contacts import PlacedBrick
from planning.lego.bricks.drawing import Spot
from planning.lego.bricks.grid import Stud, joined_to_plate, occupied_studs
from twin.scenario.document.problems import Problem
from twin.scenario.document.yaml_text import KeyPath, YamlDocument
from twin.scenario.sections.drawn_structure import (
    ReadStructure,
    mark_of_spot,
    read_structure,
)
from twin.scenario.sections.lego import LegoSection, studs_of

Found = Iterator[tuple[KeyPath, Spot | None, str]]


def find_structure_problems(
    assembly: LegoSection,
    types: Mapping[str, BrickType],
    document: YamlDocument,
    prefix: KeyPath = ("assembly", "structure"),
) -> list[Problem]:
    """Return everything in the structure of an assembly that cannot be as it is drawn.

    Args:
        assembly: with a structure; its stock consists of known brick types.
        types: brick types by name.
        document: in which the structure is written.
        prefix: where in the document the structure is.
    """
    assert assembly.structure is not None
    read = read_structure(assembly.structure, types)
    found = list(read.problems)
    if not found:
        found += _check_places(read, assembly, types)
        found += _check_joined(read, assembly, types)
        found += _check_supply(read, assembly)
    return [
        Problem(mark_of_spot(document, (*prefix, *path), spot), message)
        for path, spot, message in found
    ]


def _check_places(
    read: ReadStructure, assembly: LegoSection, types: Mapping[str, BrickType]
) -> Found:
    """No two bricks in one place, none off the plate or where the stock stands."""
    nx, ny = assembly.plate.studs
    taken: dict[Stud, str] = {}
    for item in assembly.stock:
        if item.fixed or assembly.storage_plate is None:
            words = f"{item.name} of the stock"
            taken.update(dict.fromkeys(studs_of(item, types), words))
    for brick, (path, spot) in zip(read.bricks, read.places, strict=True):
        places = occupied_studs(brick.cell, brick.brick)
        other = next((taken[p] for p in sorted(places) if p in taken), None)
        if other is not None:
            yield path, spot, f"{_words(brick)} goes where {other} already is"
        low = min(places, key=lambda p: (p[2], p))
        if low[2] < 1:
            text = f"{_words(brick)}: layer {low[2]} is below the plate"
            yield path, spot, text
        off = [
            p
            for p in sorted(places)
            if p[2] == 1 and not (0 <= p[0] < nx and 0 <= p[1] < ny)
        ]
        if off:
            yield (
                path,
                spot,
                f"{_words(brick)}: stud ({off[0][0]}, {off[0][1]}) is beyond the plate of "
                f"{nx} x {ny} studs",
            )
        taken.update(dict.fromkeys(places, brick.name))


def _check_joined(
    read: ReadStructure, assembly: LegoSection, types: Mapping[str, BrickType]
) -> Found:
    """Every brick must be joined to the plate, through others or through the scaffold."""
    fixed = [studs_of(item, types) for item in assembly.stock if item.fixed]
    studs = {k: occupied_studs(b.cell, b.brick) for k, b in enumerate(read.bricks)}
    held = joined_to_plate(studs, frozenset().union(*fixed))
    for k, (brick, (path, spot)) in enumerate(
        zip(read.bricks, read.places, strict=True)
    ):
        if k not in held:
            text = f"{_words(brick)} floats: it is not joined to the plate"
            yield path, spot, text


def _check_supply(read: ReadStructure, assembly: LegoSection) -> Found:
    """The stock must have enough bricks of every type."""
    free = [item for item in assembly.stock if not item.fixed]
    stations = {item.brick for item in free if item.station}
    supply = Counter(item.brick for item in free)
    need: Counter[str] = Counter()
    total = Counter(brick.brick.name for brick in read.bricks)
    for brick, (path, spot) in zip(read.bricks, read.places, strict=True):
        name = brick.brick.name
        need[name] += 1
        if need[name] == supply[name] + 1 and name not in stations:
            yield (
                path,
                spot,
                f"the structure needs {total[name]} bricks {name}, but the stock has "
                f"{supply[name]}",
            )


def _words(brick: PlacedBrick) -> str:
    return f"brick {brick.name} ({brick.brick.name})"
