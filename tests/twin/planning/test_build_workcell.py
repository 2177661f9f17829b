"""From sections to cell and assembly: nothing is lost, units are turned."""

from pathlib import Path

import numpy as np

from planning.lego.bricks.assembly import Cell, Press, Support
from tests.twin.written import loaded
from twin.planning.build_workcell import build_workcell
from twin.planning.lego import build_lego

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
    cell, assembly = build_workcell(scenario, tmp_path), build_lego(scenario.assembly)

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
