"""Checks that need the whole scenario: do the parts fit together?"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from planning.errors import RobotModelError, ScenarioError
from planning.lego.grid import occupied_studs
from planning.lego.objects import STORAGE
from planning.lego.stations import source_of
from planning.lego.structure import BrickType, Cell, Support
from planning.lego.support import supported_cell
from twin.scenario import (
    LegoSection,
    RobotSection,
    Scenario,
    StepSection,
    StockSection,
)
from twin.scenario_durations import EmpiricalDuration
from twin.scenario_problems import Problem, unknown_name
from twin.scenario_yaml import KeyPath, YamlDocument


def find_problems(scenario: Scenario, document: YamlDocument) -> list[Problem]:
    """Return everything in the scenario that cannot be as it is written.

    Args:
        scenario: passed the checks of its single values.
        document: where it was read from, for places and relative paths.
    """
    folder = document.path.parent
    found: list[tuple[KeyPath, str]] = []
    found += _check_robots(scenario.cell.robots, folder)
    found += _check_names(scenario)
    found += _check_durations(scenario, folder)
    found += _check_lego(scenario.assembly)
    problems = [
        Problem(document.mark_of(path, key=path[-1:] == ("name",)), message)
        for path, message in found
    ]
    return problems + _structure_problems(scenario.assembly, document)


Found = Iterator[tuple[KeyPath, str]]

Stud = tuple[int, int, int]
"""A place on the grid: stud in x and y from 0, layer from 1."""


def _check_names(scenario: Scenario) -> Found:
    """Robots have names of their own; so have fixtures and stock together."""
    robots = [
        (("cell", "robots", i, "name"), r.name)
        for i, r in enumerate(scenario.cell.robots)
    ]
    things = [
        (("cell", "fixtures", i, "name"), f.name)
        for i, f in enumerate(scenario.cell.fixtures)
    ] + [
        (("assembly", "stock", i, "name"), s.name)
        for i, s in enumerate(scenario.assembly.stock)
    ]
    stations = {s.name for s in scenario.assembly.stock if s.station}
    for group in (robots, things):
        seen: set[str] = set()
        for path, name in group:
            if name in seen:
                yield path, f"the name {name!r} is already taken"
            seen.add(name)
    for path, name in things:
        if name in {"plate", STORAGE, *(n for _, n in robots)}:
            yield path, f"the name {name!r} is that of a robot or of a plate"
        if source_of(name, stations) != name:
            yield path, f"the name {name!r} is that of a brick of a feeding station"


def _check_robots(robots: Sequence[RobotSection], folder: Path) -> Found:
    from planning.robots.registry import robot_model

    for i, robot in enumerate(robots):
        at: KeyPath = ("cell", "robots", i)
        try:
            model = robot_model(robot.model, folder)
        except (RobotModelError, ScenarioError) as error:
            if error.choices:
                text = unknown_name("robot model", robot.model, error.choices)
                yield (*at, "model"), text
            else:
                yield (*at, "model"), str(error)
            continue
        home = robot.home_deg or robot.home_rad_or_m
        key = "home_deg" if robot.home_deg else "home_rad_or_m"
        if home is not None and len(home) != model.dof:
            joints = ", ".join(model.joint_names)
            yield (
                (*at, key),
                f"{len(home)} values for the {model.dof} joints of {robot.model} ({joints})",
            )
        if robot.home_deg and model.chain.prismatic.any():
            yield (*at, key), f"{robot.model} has sliding joints: use home_rad_or_m"


def _check_durations(scenario: Scenario, folder: Path) -> Found:
    from twin.durations import Empirical

    for skill, duration in scenario.execution.skills.items():
        if isinstance(duration, EmpiricalDuration):
            file = folder / duration.csv
            at: KeyPath = ("execution", "skills", skill, "csv")
            if not file.is_file():
                yield at, f"no such file: {file}"
                continue
            try:
                Empirical.from_csv(file, duration.column)
            except ScenarioError as error:
                yield at, str(error)


def _structure_problems(assembly: LegoSection, document: YamlDocument) -> list[Problem]:
    from twin.cell import brick_types
    from twin.structure_checks import find_structure_problems

    types = brick_types(assembly)
    if assembly.structure is None or any(_unknown_bricks(assembly, types)):
        return []
    return find_structure_problems(assembly, types, document)


def _check_lego(assembly: LegoSection) -> Found:
    from twin.cell import brick_types

    types = brick_types(assembly)
    unknown = list(_unknown_bricks(assembly, types))
    yield from unknown
    if unknown:  # the checks below need every size
        return
    yield from _check_layout(assembly, types)
    yield from _check_supply(assembly)


def _unknown_bricks(assembly: LegoSection, types: Mapping[str, BrickType]) -> Found:
    groups: tuple[tuple[str, Sequence[StockSection | StepSection]], ...] = (
        ("stock", assembly.stock),
        ("steps", assembly.steps),
    )
    for group, items in groups:
        for i, item in enumerate(items):
            if item.brick not in types:
                yield (
                    ("assembly", group, i, "brick"),
                    unknown_name("brick type", item.brick, tuple(types)),
                )


def _check_layout(assembly: LegoSection, types: Mapping[str, BrickType]) -> Found:
    """No two bricks in one place, nothing off the plate, nothing in the air."""
    studs = assembly.plate.studs
    owner: dict[str, StockSection] = {s.name: s for s in assembly.stock}
    stock = list(enumerate(assembly.stock))
    taken: dict[Stud, str] = {}
    if assembly.storage_plate is None:
        yield from _check_stock(stock, types, studs, taken)
    else:
        scaffold = [(i, s) for i, s in stock if s.fixed]
        yield from _check_stock(scaffold, types, studs, taken)
        stored = [(i, s) for i, s in stock if not s.fixed]
        yield from _check_stock(stored, types, assembly.storage_plate.studs, {})

    structure = {
        cell for cell, name in taken.items() if name in owner and owner[name].fixed
    }
    for k, step in enumerate(assembly.steps):
        at = ("assembly", "steps", k)
        label = f"step {k + 1}"
        cells = _studs_of(step, types)
        source = owner.get(step.stock or "")
        if source is not None and not source.station:
            for cell in _studs_of(source, types):
                if taken.get(cell) == source.name:
                    del taken[cell]
        if message := _off_plate(cells, studs):
            yield (*at, "at"), message
        if other := _first_taken(cells, taken):
            yield (*at, "at"), f"{label} goes where {other} already is"
        elif step.place == "down" and not _touches(cells, structure, (-1,)):
            if not _on_plate(cells):
                yield (
                    (*at, "at"),
                    f"{label} would float: no stud of it is above the plate or a brick placed before",
                )
        elif step.place == "up" and not _touches(cells, structure, (1,)):
            yield (
                (*at, "at"),
                f"{label} is placed from below, but no brick placed before is above it",
            )
        taken.update(dict.fromkeys(cells, label))
        structure.update(cells)
        yield from _check_step(step, types[step.brick], at, taken)


def _check_step(
    step: StepSection,
    brick: BrickType,
    at: KeyPath,
    taken: Mapping[Stud, str],
) -> Found:
    if step.press is not None:
        along = brick.studs[1] if step.press.side in (1, 4) else brick.studs[0]
        # A one-stud edge is gripped with half of the tool beside it.
        if step.press.offset > max(along - 2, 0):
            yield (
                (*at, "press", "offset"),
                f"the edge has {along} studs: an offset of at most {max(along - 2, 0)} fits",
            )
    if step.place == "up" and step.support is None:
        yield at, "a brick placed from below needs 'support'"
    if step.support is not None:
        x, y, z = step.support.at
        support = Support(x, y, z, step.support.orientation)
        cells = [(c.x, c.y, c.z) for c in supported_cell(support)]
        if other := _first_taken(cells, taken):
            yield (*at, "support", "at"), f"the support goes where {other} is"


def _check_stock(
    stock: Sequence[tuple[int, StockSection]],
    types: Mapping[str, BrickType],
    studs: Sequence[int],
    taken: dict[Stud, str],
) -> Found:
    """Check the stock of one plate, and note the studs it takes."""
    for i, item in stock:
        at: KeyPath = ("assembly", "stock", i, "at")
        cells = _studs_of(item, types)
        if message := _off_plate(cells, studs):
            yield at, message
        if other := _first_taken(cells, taken):
            yield at, f"{item.name} stands where {other} already stands"
        taken.update(dict.fromkeys(cells, item.name))
    yield from _check_stock_stands(stock, types, taken)


def _check_stock_stands(
    stock: Sequence[tuple[int, StockSection]],
    types: Mapping[str, BrickType],
    taken: Mapping[Stud, str],
) -> Found:
    """Every stock brick must be joined to the plate through others, never through a station."""
    cells = {s.name: _studs_of(s, types) for _, s in stock}
    for i, item in stock:
        below = {taken.get((x, y, z - 1)) for x, y, z in cells[item.name]}
        for _, other in stock:
            if other.station and other.name in below:
                yield (
                    ("assembly", "stock", i, "at"),
                    f"{item.name} stands on the feeding station {other.name}",
                )
    held = {name for name, c in cells.items() if _on_plate(c)}
    frontier = list(held)
    while frontier:
        for x, y, z in cells[frontier.pop()]:
            for neighbour in ((x, y, z + 1), (x, y, z - 1)):
                name = taken.get(neighbour)
                if name is not None and name not in held:
                    held.add(name)
                    frontier.append(name)
    for i, item in stock:
        if item.name not in held and item.at[2] >= 1:
            yield (
                ("assembly", "stock", i, "at"),
                f"{item.name} floats: it is not joined to the plate",
            )


def _check_supply(assembly: LegoSection) -> Found:
    """Every step must find a brick."""
    free = [s for s in assembly.stock if not s.fixed]
    stations = {s.brick for s in free if s.station}
    supply = Counter(s.brick for s in free)
    owner = {s.name: s for s in assembly.stock}
    used: dict[str, int] = {}
    need: Counter[str] = Counter()
    for k, step in enumerate(assembly.steps):
        at: KeyPath = ("assembly", "steps", k)
        need[step.brick] += 1
        lacking = need[step.brick] > supply[step.brick]
        if lacking and step.stock is None and step.brick not in stations:
            yield (
                (*at, "brick"),
                f"step {k + 1} is the {_ordinal(need[step.brick])} to need a {step.brick}, "
                f"but the stock has {supply[step.brick]}",
            )
        if step.stock is None:
            continue
        source = owner.get(step.stock)
        if source is None:
            names = tuple(s.name for s in free)
            yield (*at, "stock"), unknown_name("stock brick", step.stock, names)
        elif source.brick != step.brick:
            yield (
                (*at, "stock"),
                f"{source.name} is a {source.brick}, step {k + 1} needs a {step.brick}",
            )
        elif source.fixed:
            yield (*at, "stock"), f"{source.name} is fixed and cannot be used"
        elif source.name in used and not source.station:
            first = used[source.name]
            yield (*at, "stock"), f"{source.name} is already used by step {first}"
        used.setdefault(step.stock, k + 1)


def _studs_of(
    item: StockSection | StepSection, types: Mapping[str, BrickType]
) -> frozenset[Stud]:
    x, y, z = item.at
    return occupied_studs(Cell(x, y, z, item.turned), types[item.brick])


def _off_plate(cells: frozenset[Stud], studs: Sequence[int]) -> str:
    for x, y, z in sorted(cells):
        if z < 1:
            return f"layer {z} is below the plate: the lowest layer is 1"
        if z == 1 and not (0 <= x < studs[0] and 0 <= y < studs[1]):
            return (
                f"stud ({x}, {y}) is beyond the plate of {studs[0]} x {studs[1]} studs"
            )
    return ""


def _first_taken(
    cells: Iterable[Stud],
    taken: Mapping[Stud, str],
) -> str:
    return next((taken[c] for c in cells if c in taken), "")


def _on_plate(cells: frozenset[Stud]) -> bool:
    return any(z == 1 for _, _, z in cells)


def _touches(
    cells: frozenset[Stud], structure: set[Stud], layers: Sequence[int]
) -> bool:
    return any((x, y, z + dz) in structure for x, y, z in cells for dz in layers)


def _ordinal(n: int) -> str:
    suffix = (
        "th" if 10 < n % 100 < 14 else {1: "st", 2: "nd", 3: "rd"}.get(n % 10, "th")
    )
    return f"{n}{suffix}"
