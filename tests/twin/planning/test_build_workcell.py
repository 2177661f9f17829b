"""From sections to cell and assembly: nothing is lost, units are turned; and what the audit is told."""

from pathlib import Path

import numpy as np
import pytest

from planning.lego.bricks.assembly import Cell, Press, Support
from planning.transforms import rotation
from tests.assembly_section import assembly_section
from tests.twin.written import loaded
from twin.audits.expectations import Expectations, scenario_expectations
from twin.kinds.lego.kind import build_lego
from twin.kinds.lego.section import LegoSection
from twin.planning.build_workcell import build_workcell
from twin.reading.scenario_file import load_scenario
from twin.scenario.sections.kind import assembly_kind

SCENARIO = """\
version: 1
name: tiny
cell:
  robots:
    - name: left
      model: gp4
      base: {xyz_m: [0, 0, 0.9], rpy_deg: [0, 0, 90]}
      home_deg: [10, -20, -30, 0, -60, 0]
      frames: {tool: {xyz_m: [0, 0, 0.2]}}
    - name: right
      model: gp4
      base: {xyz_m: [1, 0, 0.9], quat_wxyz: [0, 0, 0, 2]}
  fixtures:
    - {name: table, size_m: [1, 2, 0.1], pose: {xyz_m: [0, 0, 0.5]}}
  clearance: {robot_robot_m: 0.002}
assembly:
  kind: lego
  plate: {pose: {xyz_m: [0.5, 0, 1.1]}, studs: [32, 16]}
  bricks: {slab: {studs: [4, 4], mass_kg: 0.01}}
  stock:
    - {name: b1, brick: slab, at: [0, 0, 1]}
    - {name: b2, brick: 2x4, at: [8, 0, 1], turned: true, station: true}
  steps:
    - {brick: slab, at: [20, 4, 1], stock: b1}
    - brick: 2x4
      at: [20, 4, 2]
      turned: true
      attack: -1
      press: {side: 4, offset: 2}
      support: {at: [24, 4, 2], orientation: 1}
  twist_deg: {place-down: 20}
"""


def test_cell_and_assembly_hold_what_the_file_says(tmp_path: Path) -> None:
    scenario = loaded(tmp_path, SCENARIO)
    cell = build_workcell(scenario, tmp_path)
    assembly = build_lego(assembly_section(scenario, LegoSection))

    left, right = cell.robots
    np.testing.assert_allclose(np.rad2deg(left.home), [10, -20, -30, 0, -60, 0])
    np.testing.assert_allclose(left.base[:3, 0], [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(left.model.frames["tool"][:3, 3], [0, 0, 0.2])
    np.testing.assert_allclose(right.base[:3, 0], [-1, 0, 0], atol=1e-12)
    assert set(left.model.frames) == set(right.model.frames)
    assert not np.allclose(right.model.frames["tool"], left.model.frames["tool"])
    np.testing.assert_array_equal(right.home, right.model.home)

    assert [f.name for f in cell.fixtures] == ["table", "plate"]
    assert cell.clearances.robot_robot == 0.002
    # A station shows the first of its bricks.
    names = [(o.name, o.kind) for o in cell.objects]
    assert names == [("b1", "slab"), ("b2.1", "2x4")]
    np.testing.assert_allclose(cell.object("b1").size, [0.0318, 0.0318, 0.0096])
    # The plate's corner lies at (0.5 - 16 * 0.008, -8 * 0.008); 4 x 4 studs from there.
    np.testing.assert_allclose(
        cell.object("b1").start[:3, 3], [0.388, -0.048, 1.1 + 0.0048]
    )

    assert assembly.stock[1].station
    assert assembly.stock[0].brick.mass == 0.01
    first, second = assembly.steps
    assert (first.stock, first.press, first.attack) == ("b1", None, 1)
    assert second.cell == Cell(20, 4, 2, True)
    assert second.press == Press(4, 2)
    assert second.support == Support(Cell(24, 4, 2), 1)
    assert second.attack == -1
    np.testing.assert_allclose(np.rad2deg(assembly.twist["place-down"]), 20)
    np.testing.assert_allclose(np.rad2deg(assembly.twist["handover"]), 18)


SCENARIOS = Path(__file__).parents[3] / "scenarios"


def wanted(name: str) -> Expectations:
    return scenario_expectations(load_scenario(SCENARIOS / name))


@pytest.mark.parametrize(
    "path", sorted(SCENARIOS.glob("*/*.yaml")), ids=lambda p: str(p.stem)
)
def test_every_step_has_its_place(path: Path) -> None:
    scenario = load_scenario(path)
    kind, expected = assembly_kind(scenario.assembly), scenario_expectations(scenario)
    places = expected.places
    # Some robots only move, and what lines make leaves the cell.
    nothing = path.stem in ("multi_goal", "kitting", "machine_tending", "mix")
    processes = expected.processes
    assert len(places) == (0 if nothing else kind.steps() - len(processes))
    spots = {tuple(np.round(place.pose[:3, 3], 6)) for place in places}
    assert len(spots) == len(places)


def test_places_of_bricks() -> None:
    """By hand: the plate has 48 x 48 studs of 8 mm, its middle at (0.44, 0, 1.1145)."""
    found = wanted("lego/cliff.yaml")
    assert found.hold == "studs"
    assert (found.touch_m, found.opening_m) == (0.002, 0.0)
    first, last = found.places[0], found.places[-1]
    assert (first.words, first.kind, first.object) == (
        "step 1: 2x6 at [23, 14, 1]",
        "2x6",
        None,
    )
    assert first.pose[:3, 3] == pytest.approx([0.44, -0.056, 1.1145 + 0.0048])
    assert first.pose[:3, :3] == pytest.approx(np.eye(3))
    assert last.pose[:3, 3] == pytest.approx([0.44, 0.008, 1.1145 + 8.5 * 0.0096])
    assert [place.held for place in found.places] == [False] * 8 + [True] * 3


def test_places_of_parts() -> None:
    found = wanted("multi_arm/rearrangement.yaml")
    assert (found.hold, found.opening_m) == ("weight", 0.04)
    first = found.places[0]
    assert first.object == "rod_west"
    assert first.pose[:3, 3] == pytest.approx([-0.1, 0.0, 0.1825])
    assert first.pose[:3, :3] == pytest.approx(rotation("z", np.pi / 2)[:3, :3])


def test_places_of_a_model() -> None:
    found = wanted("construction/tower.yaml")
    assert (found.hold, found.touch_m) == ("joints", 0.03)
    heights = [place.pose[2, 3] for place in found.places]
    assert np.diff(heights) == pytest.approx(np.diff(heights)[0])
    assert all(place.object for place in found.places)
