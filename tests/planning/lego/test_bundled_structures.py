"""The nine bundled LEGO structures: valid, of the promised size, with the promised kinds of steps."""

from collections import Counter
from pathlib import Path

import pytest

from planning.lego.bricks.assembly import Cell, PlacedBrick
from planning.lego.bricks.brick_grips import check_press, press_cell
from planning.lego.bricks.brick_types import BRICKS
from planning.lego.sequencing.sequencing import sequence_structure
from planning.lego.skills.targets import supported_span
from twin.kinds.lego.kind import build_lego, build_structure
from twin.kinds.lego.section import LegoSection
from twin.reading.scenario_file import load_scenario

FOLDER = Path(__file__).parents[3] / "scenarios" / "lego"

# Name: plain steps, steps with a support-bottom, place-ups, layers.
KINDS = {
    "cliff": (8, 2, 1, 10),
    "stairs": (10, 4, 0, 11),
    "faucet": (11, 2, 1, 17),
    "bridge": (20, 18, 0, 14),
    "fish": (14, 9, 6, 16),
    "chair": (258, 0, 0, 12),
    "vessel": (36, 0, 0, 5),
    "guitar": (24, 0, 0, 20),
    "rss": (39, 6, 2, 15),
}


def load(name: str) -> LegoSection:
    lego = load_scenario(FOLDER / f"{name}.yaml").assembly
    assert isinstance(lego, LegoSection)
    return lego


def test_every_bundled_structure_is_held_to_something() -> None:
    assert {path.stem for path in FOLDER.glob("*.yaml")} == set(KINDS)


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.nightly)
        if name in ("bridge", "chair", "fish", "rss")
        else name
        for name in KINDS
    ],
)
def test_kinds_of_steps(name: str) -> None:
    lego = load(name)
    assembly, structure = build_lego(lego), build_structure(lego)
    steps = assembly.steps
    if structure is not None:
        steps = sequence_structure(structure, scaffold=assembly.scaffold).steps
    up = sum(step.up for step in steps)
    supported = sum(step.support is not None and not step.up for step in steps)
    layers = max(step.cell.z for step in steps)
    assert (len(steps) - up - supported, supported, up, layers) == KINDS[name]


@pytest.mark.parametrize("name", KINDS)
def test_both_robots_have_what_the_structure_needs(name: str) -> None:
    """Half of every type or more is on each side, and there are spare bricks."""
    lego = load(name)
    structure = build_structure(lego)
    if structure is None:
        need = Counter(step.brick for step in lego.steps)
    else:
        need = Counter(item.brick.name for item in structure)
    middle = lego.plate.studs[0] / 2
    free = [item for item in lego.stock if not item.fixed]
    stations = {(s.brick, s.at[0] < middle) for s in free if s.station}
    have = Counter((s.brick, s.at[0] < middle) for s in free)
    for brick, count in need.items():
        if stations:
            assert {(brick, True), (brick, False)} <= stations
            continue
        sides = have[brick, True], have[brick, False]
        assert min(sides) >= count / 2 or name == "cliff", brick
    assert stations or len(free) >= sum(need.values()) + 4


@pytest.mark.parametrize("name", [n for n in KINDS if n != "cliff"])
def test_the_scaffold_carries_the_structure(name: str) -> None:
    """Fixed bricks are there where the design has them, and nothing is drawn twice."""
    lego = load(name)
    assembly, structure = build_lego(lego), build_structure(lego)
    assert structure is not None
    fixed = assembly.scaffold
    assert bool(fixed) == (name in ("faucet", "fish", "rss"))
    places = [place for item in (*structure, *fixed) for place in item.places]
    assert len(places) == len(set(places))


def test_the_steps_of_the_cliff_fit_what_is_there() -> None:
    """Each brick is joined when it is placed; presses and supports are where they bear."""
    assembly = build_lego(load("cliff"))
    stock = assembly.stock
    need = Counter(step.brick for step in assembly.steps)
    have = Counter(item.brick for item in stock)
    assert all(have[brick] > count for brick, count in need.items())
    taken = {p for s in stock for p in s.places}
    filled: set[tuple[int, int, int]] = set()
    nx, ny = assembly.plate.studs
    for step in assembly.steps:
        at, brick, press = step.cell, step.brick, step.press
        own = step.places
        assert all(0 <= x < nx and 0 <= y < ny and z >= 0 for x, y, z in own)
        assert own.isdisjoint(taken | filled)
        above = {(x, y, z + 1) for x, y, z in own} & filled
        below = {(x, y, z - 1) for x, y, z in own} & filled
        assert (above and not below) if step.up else (below or at.z == 1)
        assert press is not None
        check_press(brick, press)
        contact = press_cell(step, press, up=step.up)
        assert not step.up or contact == Cell(24, 24, 8)  # as its file says
        if step.support is not None:
            tip = supported_span(step.support).places
            assert tip.isdisjoint(filled | own)
            # Something built already is right above the tip, or below it for a place-up.
            beyond = -3 if step.up else 3
            assert any((x, y, z + beyond) in filled for x, y, z in tip)
        elif at.z > 1:
            # Unsupported bricks are pressed above studs that something stands under.
            pressed = PlacedBrick("", BRICKS["1x2"], contact).studs
            assert {(x, y, at.level - 1) for x, y in pressed} <= filled
        filled |= own
