"""The bundled boat of rods: three arms, seventeen steps, from its file to runs that stall."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.stalled_runs import run_with_stalls
from scheduling.verification import verify_plan
from twin.pipeline import Planned, plan_scenario
from twin.run.folder import prepare_run_folder
from twin.scenario.file import load_scenario
from twin.scenario.scenario import Scenario
from twin.trial import Keep, Trial, try_plan

FILE = Path(__file__).parents[3] / "scenarios" / "multi_arm" / "assembly.yaml"

pytestmark = pytest.mark.expensive


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return load_scenario(FILE)


@pytest.fixture(scope="module")
def planned(scenario: Scenario) -> Planned:
    return plan_scenario(scenario, FILE.parent)


@pytest.fixture(scope="module")
def trial(
    scenario: Scenario, planned: Planned, tmp_path_factory: pytest.TempPathFactory
) -> Trial:
    folder = prepare_run_folder(tmp_path_factory.mktemp("boat") / "run", "boat")
    return try_plan(
        scenario, planned.tpg, folder, base=FILE.parent, keep=Keep(recording=False)
    )


def test_three_arms_share_seventeen_steps(planned: Planned) -> None:
    done = [choice.robot for choice in planned.task_plan.choices]
    assert len(done) == 17
    assert {name: done.count(name) for name in done} == {
        "stern": pytest.approx(5, abs=1),
        "starboard": pytest.approx(6, abs=1),
        "port": pytest.approx(6, abs=1),
    }


def test_the_run_is_complete_clean_and_twice_as_fast(trial: Trial) -> None:
    summary = trial.summary
    assert summary["outcome"] == "completed"
    assert summary["audit"]["configurations"] > 5_000
    assert summary["audit"]["violations"] == []
    assert summary["makespan_s"] <= 0.5 * summary["makespan_sequential_s"]


def test_every_pair_that_may_happen_at_once_is_apart(planned: Planned) -> None:
    report = verify_plan(planned.tpg)
    assert report.pairs_checked > 10_000
    assert report.problems == ()


def test_stalls_neither_block_it_nor_make_anything_touch(
    scenario: Scenario, planned: Planned, trial: Trial
) -> None:
    run = run_with_stalls(scenario, planned.tpg, FILE.parent, seed=1, stalls=10)
    assert run.outcome == "completed"
    assert run.violations == ()
    assert run.makespan_s > trial.summary["makespan_s"]
