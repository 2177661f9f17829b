"""Consistency checks of LEGO sections: known bricks, no overlaps, no floating bricks, and enough stock.

Given steps are checked one after another; a given structure is checked as a whole.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

from planning.lego.bricks.assembly import (
    BRICK_LEVELS,
    BrickType,
    GridPlace,
    Press,
)
from planning.lego.bricks.brick_grips import has_knobs
from planning.lego.bricks.grid import bricks_joined_to_plate
from planning.lego.skills.support_targets import supported_span
from twin.document.validation import Problems, check_known_name, unknown_name
from twin.document.yaml_text import KeyPath
from twin.kinds.lego.section import (
    BrickStepSection,
    LegoSection,
    StockSection,
    brick_cell,
    brick_types,
    filled_grid_places,
    support_place,
)
from twin.kinds.lego.structure import read_structure


def find_lego_problems(assembly: LegoSection) -> Problems:
    """Yield all inconsistencies of a LEGO section.

    Args:
        assembly: passed the checks of its single values.
    """
    types = brick_types(assembly)
    unknown = list(_unknown_bricks(assembly, types))
    yield from unknown
    if unknown:  # the other checks need every size
        return
    yield from _check_layout(assembly, types)
    yield from _check_supply(assembly)
    for path, message in find_structure_problems(assembly):
        yield ("assembly", "structure", *path), message


def _unknown_bricks(assembly: LegoSection, types: Mapping[str, BrickType]) -> Problems:
    for group in ("stock", "steps"):
        for i, item in enumerate(getattr(assembly, group)):
            at = ("assembly", group, i, "brick")
            yield from check_known_name(at, "brick type", item.brick, types)


def _check_layout(assembly: LegoSection, types: Mapping[str, BrickType]) -> Problems:
    """Yield bricks that overlap, are off the plate, or unsupported."""
    studs = assembly.plate.studs
    owner: dict[str, StockSection] = {s.name: s for s in assembly.stock}
    taken: dict[GridPlace, str] = {}
    storage = assembly.storage_plate
    stock = list(enumerate(assembly.stock))
    here = [(i, item) for i, item in stock if storage is None or item.fixed]
    yield from _check_stock(here, types, studs, taken)
    if storage is not None:
        stored = [(i, item) for i, item in stock if not item.fixed]
        yield from _check_stock(stored, types, storage.studs, {})
    structure = {cell for cell, name in taken.items() if owner[name].fixed}
    for k, step in enumerate(assembly.steps):
        at = ("assembly", "steps", k)
        label = f"step {k + 1}"
        cells = filled_grid_places(step, types)
        source = owner.get(step.stock or "")
        if source is not None and not source.station:
            for cell in filled_grid_places(source, types):
                if taken.get(cell) == source.name:
                    del taken[cell]
        if message := _off_plate(cells, studs):
            yield (*at, "at"), message
        if other := _first_taken(cells, taken):
            yield (*at, "at"), f"{label} goes where {other} already is"
        elif step.place == "down" and not (
            brick_cell(step).level == 0 or _touches(cells, structure, -1)
        ):
            text = "no stud of it is above the plate or a brick placed before"
            yield (*at, "at"), f"{label} would float: {text}"
        elif step.place == "up" and not _touches(cells, structure, 1):
            text = "is placed from below, but no brick placed before is above it"
            yield (*at, "at"), f"{label} {text}"
        taken.update(dict.fromkeys(cells, label))
        structure.update(cells)
        yield from _check_step(step, types[step.brick], at, taken)
        # Steps must keep to the rules of the assembly.
        if step.place == "up" and not assembly.rules.place_up:
            text = f"{label} places from below, which 'rules' forbid (place_up)"
            yield (*at, "place"), text
        elif step.place == "down" and step.support and not assembly.rules.support:
            text = f"{label} has a support, which 'rules' forbid (support)"
            yield (*at, "support"), text


def _check_step(
    step: BrickStepSection,
    brick: BrickType,
    at: KeyPath,
    taken: Mapping[GridPlace, str],
) -> Problems:
    if step.press is not None:
        along = brick.studs[1] if step.press.side in (1, 4) else brick.studs[0]
        # A one-stud edge is gripped with half of the tool off it.
        most = max(along - 2, 0)
        if step.press.offset > most:
            text = f"the edge has {along} studs: an offset of at most {most} fits"
            yield (*at, "press", "offset"), text
        elif not has_knobs(brick, Press(step.press.side, step.press.offset)):
            text = f"a {brick.name} has no knobs there for the tool to hold"
            yield (*at, "press"), text
    if step.place == "up" and step.support is None:
        yield at, "a brick placed from below needs 'support'"
    if step.support is not None:
        cells = supported_span(support_place(step.support)).places
        if other := _first_taken(cells, taken):
            yield (*at, "support", "at"), f"the support goes where {other} is"


def _check_stock(
    stock: Sequence[tuple[int, StockSection]],
    types: Mapping[str, BrickType],
    studs: Sequence[int],
    taken: dict[GridPlace, str],
) -> Problems:
    """Check the stock of one plate, and record its occupied studs.

    Every brick must be joined to the plate through others, never through a station.
    """
    cells = {item.name: filled_grid_places(item, types) for _, item in stock}
    for i, item in stock:
        at: KeyPath = ("assembly", "stock", i, "at")
        own = filled_grid_places(item, types)
        if message := _off_plate(own, studs):
            yield at, message
        if other := _first_taken(own, taken):
            yield at, f"{item.name} stands where {other} already stands"
        taken.update(dict.fromkeys(own, item.name))
    held = bricks_joined_to_plate(cells)
    stations = [item.name for _, item in stock if item.station]
    for i, item in stock:
        at = ("assembly", "stock", i, "at")
        below = {taken.get((x, y, k - 1)) for x, y, k in cells[item.name]}
        for station in stations:
            if station in below - {item.name}:
                yield at, f"{item.name} stands on the feeding station {station}"
        if item.name not in held and item.at[2] >= 1:
            yield at, f"{item.name} floats: it is not joined to the plate"


def _check_supply(assembly: LegoSection) -> Problems:
    """Yield steps without a brick in stock."""
    free, stations, supply = _free_stock(assembly)
    owner = {s.name: s for s in assembly.stock}
    used: dict[str, int] = {}
    need: Counter[str] = Counter()
    for k, step in enumerate(assembly.steps):
        at: KeyPath = ("assembly", "steps", k)
        need[step.brick] += 1
        lacking = need[step.brick] > supply[step.brick]
        if lacking and step.stock is None and step.brick not in stations:
            text = f"is the {_ordinal(need[step.brick])} to need a {step.brick}"
            have = f"but the stock has {supply[step.brick]}"
            yield (*at, "brick"), f"step {k + 1} {text}, {have}"
        if step.stock is None:
            continue
        source = owner.get(step.stock)
        if source is None:
            names = tuple(s.name for s in free)
            yield (*at, "stock"), unknown_name("stock brick", step.stock, names)
        elif source.brick != step.brick:
            text = (
                f"{source.name} is a {source.brick}, step {k + 1} needs a {step.brick}"
            )
            yield (*at, "stock"), text
        elif source.fixed:
            yield (*at, "stock"), f"{source.name} is fixed and cannot be used"
        elif source.name in used and not source.station:
            first = used[source.name]
            yield (*at, "stock"), f"{source.name} is already used by step {first}"
        used.setdefault(step.stock, k + 1)


def _free_stock(
    assembly: LegoSection,
) -> tuple[list[StockSection], set[str], Counter[str]]:
    """Return the stock available to steps, the types of its stations, and counts by type."""
    free = [item for item in assembly.stock if not item.fixed]
    stations = {item.brick for item in free if item.station}
    return free, stations, Counter(item.brick for item in free)


def _off_plate(
    cells: Iterable[GridPlace],
    studs: Sequence[int],
    hint: str = ": the lowest layer is 1",
) -> str:
    for x, y, level in sorted(cells, key=lambda cell: (cell[2], cell)):
        if level < 0:
            layer = level // BRICK_LEVELS + 1
            return f"layer {layer} is below the plate{hint}"
        if level == 0 and not (0 <= x < studs[0] and 0 <= y < studs[1]):
            return (
                f"stud ({x}, {y}) is beyond the plate of {studs[0]} x {studs[1]} studs"
            )
    return ""


def _first_taken(cells: Iterable[GridPlace], taken: Mapping[GridPlace, str]) -> str:
    return next((taken[c] for c in cells if c in taken), "")


def _touches(cells: frozenset[GridPlace], structure: set[GridPlace], up: int) -> bool:
    return any((x, y, level + up) in structure for x, y, level in cells)


def _ordinal(n: int) -> str:
    teen = 10 < n % 100 < 14
    return f"{n}{'th' if teen else {1: 'st', 2: 'nd', 3: 'rd'}.get(n % 10, 'th')}"


def find_structure_problems(assembly: LegoSection) -> Problems:
    """Yield all inconsistencies of a drawn structure.

    No two bricks in one place, none off the plate or in the air, and enough in stock.

    Args:
        assembly: its stock consists of known brick types.
    """
    if assembly.structure is None:
        return
    types = brick_types(assembly)
    read = read_structure(assembly.structure, types)
    yield from read.problems
    if read.problems:
        return
    taken: dict[GridPlace, str] = {}
    for item in assembly.stock:
        if item.fixed or assembly.storage_plate is None:
            words = f"{item.name} of the stock"
            taken.update(dict.fromkeys(filled_grid_places(item, types), words))
    studs = {k: brick.places for k, brick in enumerate(read.bricks)}
    fixed = [filled_grid_places(item, types) for item in assembly.stock if item.fixed]
    held = bricks_joined_to_plate(studs, frozenset().union(*fixed))
    _, stations, supply = _free_stock(assembly)
    total = Counter(brick.brick.name for brick in read.bricks)
    need: Counter[str] = Counter()
    for k, path in enumerate(read.places):
        brick, kind = read.bricks[k], read.bricks[k].brick.name
        words, places = f"brick {brick.name} ({kind})", sorted(studs[k])
        if other := _first_taken(places, taken):
            yield path, f"{words} goes where {other} already is"
        if message := _off_plate(places, assembly.plate.studs, ""):
            yield path, f"{words}: {message}"
        taken.update(dict.fromkeys(places, brick.name))
        if k not in held:
            yield path, f"{words} floats: it is not joined to the plate"
        need[kind] += 1
        if need[kind] == supply[kind] + 1 and kind not in stations:
            text = f"the structure needs {total[kind]} bricks {kind}, but the stock has"
            yield path, f"{text} {supply[kind]}"
