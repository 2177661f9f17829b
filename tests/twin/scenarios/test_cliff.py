"""The bundled cliff, from its file to runs that nothing can be held against."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.stalled_runs import run_with_stalls
from planning.tasks.task import TRANSIT
from scheduling.verification.verify import verify_plan
from twin.scenario.sections.scenario import Scenario
from twin.trial.plan_result import PlanResult
from twin.trial.run_result import RunResult
from twin.trial.simulation import audit_standing_states

FILE = Path(__file__).parents[3] / "scenarios" / "lego" / "cliff.yaml"


@pytest.fixture(scope="module")
def file() -> Path:
    return FILE


def test_it_is_what_it_says(planned: PlanResult) -> None:
    kinds = {task.kind for task in planned.tpg.tasks}
    assert len(planned.motions.assembly.steps) == 11
    assert {"support-bottom", "place-up", "handover", "support-top"} <= kinds


def test_the_run_is_complete_clean_and_a_quarter_faster(trial: RunResult) -> None:
    summary = trial.summary
    assert summary["outcome"] == "completed"
    assert summary["audit"]["configurations"] > 2_000
    assert summary["audit"]["violations"] == []
    assert summary["makespan_s"] <= 0.75 * summary["makespan_sequential_s"]


def test_the_sequential_baseline_is_close_to_straight_lines(
    planned: PlanResult,
) -> None:
    taken = straight = 0.0
    for task, motion in zip(
        planned.motions.motion_plan.tasks,
        planned.motions.motion_plan.motions,
        strict=True,
    ):
        seconds = motion.time[-1] - motion.time[0]
        taken += seconds
        straight += (
            np.abs(motion.path[-1] - motion.path[0]).sum()
            if task.kind == TRANSIT
            else seconds
        )
    assert taken <= 1.1 * straight


def test_every_pair_that_may_happen_at_once_is_apart(planned: PlanResult) -> None:
    report = verify_plan(planned.tpg)
    assert report.pairs_checked > 100_000
    assert report.problems == ()


def test_a_robot_that_never_goes_on_is_not_run_into(planned: PlanResult) -> None:
    report = audit_standing_states(planned.tpg)
    assert report.states >= len(planned.tpg.edges)
    assert report.violations == ()


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_stalls_neither_block_it_nor_make_anything_touch(
    scenario: Scenario, planned: PlanResult, trial: RunResult, seed: int
) -> None:
    run = run_with_stalls(scenario, planned.tpg, FILE.parent, seed, stalls=20)
    assert run.outcome == "completed"
    assert run.violations == ()
    assert run.makespan_s > trial.summary["makespan_s"]
