"""A scenario is planned from end to end, and the bricks end up where the file says."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from planning.lego.bricks.grid import box_pose
from planning.motion.sequential import MotionSettings
from planning.motion.speed import L1Speed
from scheduling.build_tpg import build_tpg
from scheduling.graph.barriers import with_barriers
from scheduling.graph.rollout import earliest_times
from scheduling.verification.verify import verify_plan
from tests.scheduling.mini_world import random_plan
from tests.twin.planning.facing_arms import FACING_ARMS
from tests.twin.scenarios.executed import executed
from tests.twin.written import loaded
from twin.host.progress import StageWatch
from twin.planning import pipeline
from twin.planning.pipeline import MOTION
from twin.scenario.sections.scenario import Scenario
from twin.trial.plan_result import PlanResult
from twin.trial.planning import plan_scenario
from twin.trial.run_result import RunResult

SCENARIO = (
    FACING_ARMS
    + """\
  stock:
    - {name: left_a, brick: 2x4, at: [2, 30, 1]}
    - {name: left_b, brick: 2x4, at: [6, 30, 1]}
    - {name: right_a, brick: 2x4, at: [44, 30, 1]}
    - {name: right_b, brick: 2x4, at: [40, 30, 1]}
  steps:
    - {brick: 2x4, at: [23, 15, 1], press: {side: 1, offset: 1}}
    - {brick: 2x4, at: [23, 15, 2], press: {side: 1, offset: 1}, stock: left_b}
    - {brick: 2x4, at: [23, 15, 3], press: {side: 1, offset: 1}}
"""
)


@pytest.fixture(scope="module")
def scenario(tmp_path_factory: pytest.TempPathFactory) -> Scenario:
    return loaded(tmp_path_factory.mktemp("three"), SCENARIO)


@pytest.fixture(scope="module")
def planned(scenario: Scenario) -> PlanResult:
    return plan_scenario(scenario)


@pytest.fixture(scope="module")
def trial(
    scenario: Scenario,
    planned: PlanResult,
    tmp_path_factory: pytest.TempPathFactory,
) -> RunResult:
    return executed(scenario, planned.tpg, tmp_path_factory.mktemp("run"))


def test_the_plan_uses_the_stock_that_is_prescribed(planned: PlanResult) -> None:
    assert planned.motions.task_plan[2].object == "left_b"
    assert len({planned.motions.task_plan[k].object for k in (1, 2, 3)}) == 3
    stages = {"assignment", "motion", "assignment_search", "tpg", "shortcut"}
    assert set(planned.planning_s) == stages


def test_the_same_seed_gives_the_same_plan(
    scenario: Scenario, planned: PlanResult
) -> None:
    seen: list[tuple[str, float, float]] = []
    again = plan_scenario(scenario, Path(), lambda *stage: seen.append(stage))
    np.testing.assert_array_equal(again.tpg.edges, planned.tpg.edges)
    for ours, theirs in zip(planned.tpg.chains, again.tpg.chains, strict=True):
        np.testing.assert_array_equal(ours.waypoints, theirs.waypoints)
        np.testing.assert_array_equal(ours.duration, theirs.duration)
    assert [s[1:] for s in seen if s[0] == MOTION] == [(0, 3), (1, 3), (2, 3), (3, 3)]


def test_the_plan_is_safe_by_the_other_proof(planned: PlanResult) -> None:
    report = verify_plan(planned.tpg)
    assert report.problems == ()


def test_bricks_end_where_the_file_says_and_the_audit_is_clean(
    planned: PlanResult, trial: RunResult
) -> None:
    last = {}
    for row in pq.read_table(trial.files / "objects.parquet").to_pylist():
        last[row["object"]] = row
    for choice in planned.motions.task_plan.choices:
        step = planned.motions.assembly.steps[choice.step - 1]
        goal = box_pose(planned.motions.assembly.plate, step)
        assert last[choice.object]["parent"] == "world"
        np.testing.assert_allclose(last[choice.object]["xyz"], goal[:3, 3], atol=1e-9)
    untouched = {o.name for o in planned.motions.cell.objects} - {
        c.object for c in planned.motions.task_plan.choices
    }
    for name in untouched:
        start = planned.motions.cell.object(name).start
        np.testing.assert_allclose(last[name]["xyz"], start[:3, 3], atol=1e-12)


def test_asynchronous_execution_is_between_its_bounds(trial: RunResult) -> None:
    summary = trial.summary
    assert summary["lower_bound_s"] <= summary["makespan_s"] + 1e-9
    assert summary["makespan_s"] < summary["makespan_sequential_s"]
    assert all(wait >= 0 for wait in summary["wait_s"].values())


def test_with_sidesteps_the_planned_order_of_tasks_has_a_chance_too(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    plan = random_plan(3, 8, rounds=10)
    speeds = {robot.name: L1Speed() for robot in plan.cell.robots}
    settings, tpg = MotionSettings({}, speeds, 0.15, {}), build_tpg(plan)
    # An order that is no better: everything one task after another.
    worse = with_barriers(replace(tpg, slots=np.arange(len(tpg.tasks))))
    monkeypatch.setattr(pipeline, "reorder_tasks", lambda tpg, *_: worse)

    def ends(sidesteps: int) -> float:
        found = pipeline.shorten_plan(
            tpg, settings, StageWatch(), candidates=50, seed=0, sidesteps=sidesteps
        )
        return float(earliest_times(found).makespan)

    assert ends(50) < 0.9 * ends(0)
