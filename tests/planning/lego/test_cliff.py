"""The cliff that ships with the package can be built the way its file says."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import pytest
import yaml

from planning.lego.bricks.assembly import BRICKS, Cell, Plate, Press, Support
from planning.lego.bricks.grid import (
    covered_studs,
    occupied_places,
)
from planning.lego.bricks.grips import check_press, press_cell
from planning.lego.skills.targets import supported_span
from planning.transforms import identity

FILE = Path(__file__).parents[3] / "scenarios/lego/cliff.yaml"
PLATE = Plate(identity())


@pytest.fixture(scope="module")
def assembly() -> dict[str, Any]:
    """Read the assembly section of the scenario."""
    section: dict[str, Any] = yaml.safe_load(FILE.read_text())["assembly"]
    return section


def cell(section: dict[str, Any]) -> Cell:
    """Return where a brick of the file stands."""
    x, y, z = section["at"]
    return Cell(x, y, z, section.get("turned", False))


def test_eleven_bricks_and_every_kind_of_step(assembly: dict[str, Any]) -> None:
    steps = assembly["steps"]
    assert len(steps) == 11
    up = [s for s in steps if s.get("place") == "up"]
    assert len(up) == 1
    assert len([s for s in steps if "support" in s]) - len(up) == 2


def test_the_stock_leaves_a_choice(assembly: dict[str, Any]) -> None:
    need = Counter(s["brick"] for s in assembly["steps"])
    have = Counter(s["brick"] for s in assembly["stock"])
    assert all(have[brick] > count for brick, count in need.items())


def studs(item: dict[str, Any]) -> frozenset[tuple[int, int, int]]:
    return occupied_places(cell(item), BRICKS[item["brick"]])


def test_every_brick_is_joined_when_it_is_placed(assembly: dict[str, Any]) -> None:
    stock = {p for s in assembly["stock"] for p in studs(s)}
    placed: set[tuple[int, int, int]] = set()
    nx, ny = PLATE.studs
    for step in assembly["steps"]:
        own = studs(step)
        assert all(0 <= x < nx and 0 <= y < ny and z >= 0 for x, y, z in own)
        assert own.isdisjoint(stock | placed)
        above = {(x, y, z + 1) for x, y, z in own} & placed
        below = {(x, y, z - 1) for x, y, z in own} & placed
        if step.get("place") == "up":
            assert above
            assert not below
        else:
            assert below or step["at"][2] == 1
        placed |= own


def test_presses_and_supports_fit_the_structure(assembly: dict[str, Any]) -> None:
    filled: set[tuple[int, int, int]] = set()
    for step in assembly["steps"]:
        at, brick = cell(step), BRICKS[step["brick"]]
        press = Press(**step["press"])
        check_press(brick, press)
        up = step.get("place") == "up"
        if up:
            assert press_cell(at, brick, press, up=True) == cell(step["press_cell"])
        if "support" in step:
            x, y, z = step["support"]["at"]
            support = Support(x, y, z, step["support"]["orientation"])
            tip = supported_span(support).places
            assert tip.isdisjoint(filled | occupied_places(at, brick))
            # Something built already is right above the tip, or below it for a place-up.
            step_z = -3 if up else 3
            assert any((x, y, z + step_z) in filled for x, y, z in tip)
        elif at.z > 1:
            # Unsupported bricks are pressed above studs that something stands under.
            contact = press_cell(at, brick, press, up=False)
            under = {
                (x, y, at.level - 1) for x, y in covered_studs(contact, BRICKS["1x2"])
            }
            assert under <= filled
        filled |= occupied_places(at, brick)
