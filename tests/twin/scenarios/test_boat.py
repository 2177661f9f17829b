"""The bundled boat of rods: three arms, seventeen steps, from its file to runs that stall."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.stalled_runs import run_with_stalls
from scheduling.verification.verify import verify_plan
from twin.scenario.sections.scenario import Scenario
from twin.trial.plan_result import PlanResult
from twin.trial.run_result import RunResult

FILE = Path(__file__).parents[3] / "scenarios" / "multi_arm" / "assembly.yaml"

pytestmark = pytest.mark.expensive


@pytest.fixture(scope="module")
def file() -> Path:
    return FILE


def test_three_arms_share_seventeen_steps(planned: PlanResult) -> None:
    done = [choice.robot for choice in planned.motions.task_plan.choices]
    assert len(done) == 17
    assert {name: done.count(name) for name in done} == {
        "stern": pytest.approx(5, abs=1),
        "starboard": pytest.approx(6, abs=1),
        "port": pytest.approx(6, abs=1),
    }


def test_the_run_is_complete_clean_and_twice_as_fast(trial: RunResult) -> None:
    summary = trial.summary
    assert summary["outcome"] == "completed"
    assert summary["audit"]["configurations"] > 4_000
    assert summary["audit"]["violations"] == []
    assert summary["makespan_s"] <= 0.5 * summary["makespan_sequential_s"]


def test_every_pair_that_may_happen_at_once_is_apart(planned: PlanResult) -> None:
    report = verify_plan(planned.tpg)
    assert report.pairs_checked > 10_000
    assert report.problems == ()


def test_stalls_neither_block_it_nor_make_anything_touch(
    scenario: Scenario, planned: PlanResult, trial: RunResult
) -> None:
    run = run_with_stalls(scenario, planned.tpg, FILE.parent, seed=1, stalls=10)
    assert run.outcome == "completed"
    assert run.violations == ()
    assert run.makespan_s > trial.summary["makespan_s"]
