"""Stock on a plate of its own: lower, turned, next to the plate of the structure."""

from pathlib import Path

import numpy as np
import pytest

from scheduling.verification.verify import verify_plan
from tests.twin.scenarios.cells import GP4S, cell
from tests.twin.scenarios.executed import executed
from twin.scenario.sections.scenario import Scenario
from twin.trial.plan_result import PlanResult

SCENARIO = cell(
    "stored",
    GP4S,
    """\
  kind: lego
  plate: {pose: {xyz_m: [0.44, 0.15, 1.1145]}, studs: [48, 24]}
  storage_plate: {pose: {xyz_m: [0.44, -0.15, 1.1045], rpy_deg: [0, 0, 10]}, studs: [48, 16]}
  stock:
    - {name: near, brick: 2x4, at: [8, 4, 1], station: true}
    - {name: low, brick: 2x4, at: [34, 4, 1]}
    - {name: high, brick: 2x4, at: [34, 4, 2]}
    - {name: base, brick: 2x4, at: [34, 4, 1], fixed: true}
  steps:
    - {brick: 2x4, at: [24, 4, 1], press: {side: 1, offset: 1}, stock: high}
    - {brick: 2x4, at: [24, 4, 2], press: {side: 4, offset: 1}, stock: near}
    - {brick: 2x4, at: [34, 4, 2], press: {side: 4, offset: 1}, stock: low}
""",
    "{name: table, size_m: [0.6, 1.2, 0.02], pose: {xyz_m: [0.44, 0, 1.0945]}}",
)


def test_stock_and_scaffolding_stand_on_their_plates(planned: PlanResult) -> None:
    cell = planned.motions.cell
    assert [f.name for f in cell.fixtures] == ["table", "plate", "storage-plate"]
    # The same grid place on two plates: 34 studs of 8 mm and half a brick from each corner.
    away = np.array([34 * 0.008 + 0.008 - 0.192, 4 * 0.008 + 0.016])
    turn = np.deg2rad(10.0)
    lower = away - [0.0, 0.064]
    turned = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]] @ lower
    np.testing.assert_allclose(
        cell.object("low").start[:3, 3],
        [0.44 + turned[0], -0.15 + turned[1], 1.1045 + 0.0048],
    )
    np.testing.assert_allclose(
        cell.object("base").start[:3, 3],
        [0.44 + away[0], 0.15 + away[1] - 0.096, 1.1145 + 0.0048],
    )
    assert cell.object("high").start[2, 3] == pytest.approx(1.1045 + 0.0144)


def test_the_plan_is_safe_and_the_run_clean(
    scenario: Scenario, planned: PlanResult, tmp_path: Path
) -> None:
    assert verify_plan(planned.tpg).problems == ()
    executed(scenario, planned.tpg, tmp_path)


def test_bricks_of_two_plates_are_no_neighbours(planned: PlanResult) -> None:
    """The picked brick may touch what stands below it, not what has the same place elsewhere."""
    pick = next(t for t in planned.tpg.tasks if t.kind == "pick" and t.object == "high")
    pairs = {
        frozenset((a.first, a.second))
        for a in planned.tpg.allowed
        if pick.index in a.tasks
    }
    assert frozenset(("high", "low")) in pairs
    assert frozenset(("high", "base")) not in pairs
