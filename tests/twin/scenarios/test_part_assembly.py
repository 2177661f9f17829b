"""An assembly of parts from its file to a clean run, and what is said of a bad one."""

import numpy as np
import pyarrow.parquet as pq

from scheduling.verification.verify import verify_plan
from tests.assembly_section import assembly_section
from tests.twin.scenarios.cells import cell, panda
from twin.kinds.parts.section import PartsSection
from twin.scenario.sections.scenario import Scenario
from twin.trial.plan_result import PlanResult
from twin.trial.run_result import RunResult

SCENARIO = cell(
    "crossing",
    (panda("west", -0.5), panda("east", 0.5)),
    """\
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
""",
)


def test_both_robots_work_and_the_plan_is_safe_by_the_other_proof(
    planned: PlanResult,
) -> None:
    choices = planned.motions.task_plan.choices
    assert {choice.robot for choice in choices} == {"west", "east"}
    assert set(planned.planning_s) == {"assignment", "motion", "tpg", "shortcut"}
    assert verify_plan(planned.tpg).problems == ()


def test_parts_end_at_their_goals_and_the_audit_is_clean(
    scenario: Scenario, trial: RunResult
) -> None:
    assert trial.passed
    last = {}
    for row in pq.read_table(trial.files / "objects.parquet").to_pylist():
        last[row["object"]] = row
    for part in assembly_section(scenario, PartsSection).parts:
        goal_or_start = part.goal or part.start
        assert goal_or_start is not None
        goal = goal_or_start.transform()
        assert last[part.name]["parent"] == "world"
        np.testing.assert_allclose(last[part.name]["xyz"], goal[:3, 3], atol=1e-9)


def test_the_robots_work_at_the_same_time(trial: RunResult) -> None:
    summary = trial.summary
    assert summary["lower_bound_s"] <= summary["makespan_s"] + 1e-9
    assert summary["makespan_s"] < 0.9 * summary["makespan_sequential_s"]
