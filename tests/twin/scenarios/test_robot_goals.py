"""Robots that stand at each other's goals: planned, proved, executed and audited, or refused with both names."""

from pathlib import Path

import pytest

from tests.twin.scenarios.cells import cell, panda
from tests.twin.scenarios.executed import built
from tests.twin.written import checked, written
from twin.reading.scenario_file import load_scenario
from twin.trial.planning import plan_scenario

SWAP = cell(
    "swap",
    (panda("left", -0.5), panda("right", 0.5)),
    """\
  kind: goals
  moves:
    - {robot: left, to: {xyz_m: [0, 0.25, 0.3], rpy_deg: [180, 0, 0]}}
    - {robot: right, to: {xyz_m: [0, -0.25, 0.3], rpy_deg: [180, 0, 0]}}
    - {robot: left, to: {xyz_m: [0, -0.25, 0.3], rpy_deg: [180, 0, 0]}}
    - {robot: right, to: {xyz_m: [0, 0.25, 0.3], rpy_deg: [180, 0, 0]}}
planning: {shortcut_candidates: 20, sidestep_candidates: 0}
""",
)
STOP = "    - {robot: right, to: {xyz_m: [0, 0.25, 0.3], rpy_deg: [180, 0, 0]}}\n"

RING = cell(
    "ring",
    tuple(
        f"{{name: {name}, model: panda, base: {{xyz_m: [{x}, {y}, 0], rpy_deg: [0, 0, {yaw}]}}}}"
        for name, x, y, yaw in (
            ("east", 0.6, 0.0, 180),
            ("north", -0.3, 0.52, -60),
            ("south", -0.3, -0.52, 60),
        )
    ),
    """\
  kind: goals
  moves:
    - {robot: east, to: {xyz_m: [0.22, 0, 0.3], rpy_deg: [180, 0, 0]}}
    - {robot: north, to: {xyz_m: [-0.11, 0.19, 0.3], rpy_deg: [180, 0, 0]}}
    - {robot: south, to: {xyz_m: [-0.11, -0.19, 0.3], rpy_deg: [180, 0, 0]}}
    - {robot: east, to: {xyz_m: [-0.11, 0.19, 0.3], rpy_deg: [180, 0, 0]}}
    - {robot: north, to: {xyz_m: [-0.11, -0.19, 0.3], rpy_deg: [180, 0, 0]}}
    - {robot: south, to: {xyz_m: [0.22, 0, 0.3], rpy_deg: [180, 0, 0]}}
""",
)


def test_two_arms_change_places(tmp_path: Path) -> None:
    plan = built(tmp_path, SWAP)
    labels = [task.label for task in plan.tpg.tasks]
    assert "out of the way of goal 3" in labels
    ends = {task.robot: task.label for task in plan.tpg.tasks}
    assert ends == {"left": "to goal 3", "right": "to goal 4"}


def test_the_bound_of_goals_ends_at_the_last_goals(tmp_path: Path) -> None:
    scenario = load_scenario(written(tmp_path, SWAP))
    plan = plan_scenario(scenario, tmp_path, bound=True)
    assert plan.makespan_bound_s is not None
    assert plan.makespan_bound_s <= plan.makespan_s + 1e-9


def test_one_place_for_two_at_the_end_is_refused_by_check(tmp_path: Path) -> None:
    file = written(tmp_path, SWAP, (STOP, ""))
    (error,) = checked(file).errors
    assert error.at == ("assembly", "moves", 2)
    assert "right stands there at goal 2, its last" in error.message


@pytest.mark.nightly
def test_three_arms_change_places_in_a_ring(tmp_path: Path) -> None:
    plan = built(tmp_path, RING)
    assert len(plan.tpg.tasks) > 6
