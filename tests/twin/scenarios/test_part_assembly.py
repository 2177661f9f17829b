"""An assembly of parts from its file to a clean run, and what is said of a bad one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from scheduling.verification.verify import verify_plan
from twin.cli import app
from twin.scenario.document.validation import InvalidScenarioError
from twin.scenario.manifest import load_scenario
from twin.scenario.sections.scenario import Scenario
from twin.scenario.sections.shapes import build_transform
from twin.trial.plan_result import PlanResult
from twin.trial.run_result import RunResult

SCENARIO = """\
version: 1
name: crossing
cell:
  robots:
    - {name: west, model: panda, base: {xyz_m: [-0.5, 0, 0]}}
    - {name: east, model: panda, base: {xyz_m: [0.5, 0, 0], rpy_deg: [0, 0, 180]}}
  fixtures:
    - {name: table, size_m: [1.6, 1.4, 0.02], pose: {xyz_m: [0, 0, -0.01]}}
assembly:
  kind: assembly
  grips: {positions: 3}
  parts:
    - name: south
      size_m: [0.2, 0.024, 0.024]
      start: {xyz_m: [-0.15, -0.45, 0.0125]}
      goal: {xyz_m: [0, -0.06, 0.0125]}
    - name: north
      size_m: [0.2, 0.024, 0.024]
      start: {xyz_m: [0.15, 0.45, 0.0125]}
      goal: {xyz_m: [0, 0.06, 0.0125]}
    - name: across
      size_m: [0.2, 0.024, 0.024]
      start: {xyz_m: [-0.15, 0.45, 0.0125]}
      goal: {xyz_m: [0, 0, 0.037], rpy_deg: [0, 0, 90]}
    - name: bystander
      size_m: [0.05, 0.05, 0.05]
      start: {xyz_m: [0, 0.6, 0.0255]}
  steps: [south, north, across]
planning: {speed_rad_s: 4.0}
execution:
  skills:
    pick: {kind: fixed, value_s: 1.5}
    place-down: {kind: lognormal, median_s: 1.5, p95_s: 2.0}
"""


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("crossing") / "crossing.yaml"
    file.write_text(SCENARIO)
    return file


def test_both_robots_work_and_the_plan_is_safe_by_the_other_proof(
    planned: PlanResult,
) -> None:
    assert {choice.robot for choice in planned.motions.task_plan.choices} == {
        "west",
        "east",
    }
    assert set(planned.planning_s) == {"assignment", "motion", "tpg", "shortcut"}
    assert verify_plan(planned.tpg).problems == ()


def test_parts_end_at_their_goals_and_the_audit_is_clean(
    scenario: Scenario, trial: RunResult
) -> None:
    import pyarrow.parquet as pq

    assert trial.passed
    assert trial.summary["audit"]["violations"] == []
    last = {}
    for row in pq.read_table(trial.folder / "objects.parquet").to_pylist():
        last[row["object"]] = row
    for part in scenario.assembly.parts:
        goal = build_transform(part.goal or part.start)
        assert last[part.name]["parent"] == "world"
        np.testing.assert_allclose(last[part.name]["xyz"], goal[:3, 3], atol=1e-9)


def test_the_robots_work_at_the_same_time(trial: RunResult) -> None:
    summary = trial.summary
    assert summary["lower_bound_s"] <= summary["makespan_s"] + 1e-9
    assert summary["makespan_s"] < 0.9 * summary["makespan_sequential_s"]


def test_validate_says_what_is_in_it(file: Path) -> None:
    result = CliRunner().invoke(app, ["validate", str(file)])
    assert result.exit_code == 0
    assert "ok (2 robots, 3 steps, 4 parts)" in result.output


@pytest.mark.parametrize(
    ("change", "with_", "line", "message"),
    [
        ("steps: [south,", "steps: [sout,", 28, "south"),
        ("north, across]", "north, north]", 28, "already placed in step 2"),
        ("across]", "bystander]", 28, "bystander has no goal"),
        ("name: bystander", "name: north", 25, "already taken"),
        ("name: bystander", "name: east", 25, "is that of a robot"),
        ("kind: assembly", "kind: assemble", 10, "assembly"),
        (
            "kind: assembly",
            "kind: pick-and-place",
            10,
            "the kind 'pick-and-place' is called 'assembly'",
        ),
        ("positions: 3", "directions: [[0, 0, 0]]", 11, "must not be zero"),
    ],
)
def test_problems_are_found_at_their_lines(
    tmp_path: Path, change: str, with_: str, line: int, message: str
) -> None:
    file = tmp_path / "bad.yaml"
    assert SCENARIO.count(change) == 1
    file.write_text(SCENARIO.replace(change, with_))
    with pytest.raises(InvalidScenarioError) as caught:
        load_scenario(file)
    problem = caught.value.problems[0]
    assert problem.mark.line == line
    assert message in problem.message
