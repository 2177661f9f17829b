"""A study in which what fails is planned anew is so many operations of the cell, one by one."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

import twin
from planning.errors import RequestError
from tests.twin.operate.operated import STACK
from twin.api.studies import Study
from twin.operate.operation import Operation, operate
from twin.study.folder import BLOCKS, REPLICATIONS, SUMMARY
from twin.study.replications import runner
from twin.trial.loaded_scenario import LoadedScenario, load
from twin.trial.plan_result import PlanResult
from twin.trial.planning import plan_to_operate
from twin.trial.simulation import scenario_execution

COUNT = 40
OFTEN = {
    "failures.pick": {"probability": 0.03, "retries": 0, "loses": 0.5},
    "failures.place-down": {"probability": 0.2, "retries": 0, "loses": 0.3},
    "recovery.again": 1,
}


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> LoadedScenario:
    file = tmp_path_factory.mktemp("stack") / "stack.yaml"
    file.write_text(STACK)
    return load(file).varied(OFTEN)


@pytest.fixture(scope="module")
def plan(case: LoadedScenario) -> PlanResult:
    return plan_to_operate(case)


def studied(
    plan: PlanResult | LoadedScenario, out: Path, count: int = COUNT, **options: Any
) -> Study:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("twin.api.studies.write_report", lambda result, progress: None)
        # Several blocks, as of a longer study.
        patch.setattr(runner, "EVENTS_BLOCK", 8)
        return twin.study(plan, replications=count, out=out, **options)


@pytest.fixture(scope="module")
def study(plan: PlanResult, tmp_path_factory: pytest.TempPathFactory) -> Study:
    return studied(plan, tmp_path_factory.mktemp("study") / "out", operate=True)


@pytest.fixture(scope="module")
def operations(plan: PlanResult) -> list[Operation]:
    case = plan.scenario
    about = case.sections, plan.motions, plan.tpg, scenario_execution(case.sections)
    return [
        operate(*about, seed=case.sections.seed, replication=k) for k in range(COUNT)
    ]


def test_it_is_one_operation_after_the_other(
    study: Study, operations: list[Operation]
) -> None:
    rows = study.replications.to_pylist()
    assert any(done.given_up for done in operations)
    assert 5 < sum(bool(done.versions) for done in operations) < COUNT
    for row, done in zip(rows, operations, strict=True):
        record = done.record
        assert row["outcome"] == record.outcome
        assert round(row["makespan_s"] * 1e9) == record.makespan_ns
        assert row["given_up"] == " ".join(map(str, sorted(done.given_up)))
        assert row["versions"] == len(done.versions)
        failures = sum(task.kind == "failed-attempt" for task in done.tpg.tasks)
        rungs = ("done_again", "begun_anew", "not_done_any_more")
        assert sum(row[name] for name in rungs) == failures
        if record.outcome != "completed":
            assert row["wait_total_s"] != row["wait_total_s"]
            continue
        # What robots did, and what they waited, is all of their time.
        ends = [int(own.max(initial=0)) for own in record.end_ns]
        spent = row["wait_total_s"] + row["busy_s_left"] + row["busy_s_right"]
        assert spent == pytest.approx(sum(ends) / 1e9)


def test_what_is_gone_on_with_and_other_workers_make_the_same_files(
    study: Study, plan: PlanResult, tmp_path: Path
) -> None:
    killed = tmp_path / "killed"
    shutil.copytree(study.folder, killed)
    for name in (REPLICATIONS, SUMMARY):
        (killed / name).unlink()
    blocks = sorted((killed / BLOCKS).glob("*.npz"))
    assert len(blocks) == 5
    for file in blocks[::2]:
        file.unlink()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("twin.api.studies.write_report", lambda result, progress: None)
        patch.setattr(runner, "EVENTS_BLOCK", 8)
        twin.resume_study(killed)
    with_two = studied(plan, tmp_path / "two", operate=True, workers=2)
    for name in (REPLICATIONS, SUMMARY, "tasks.parquet", "gains.json"):
        there = (study.folder / name).read_bytes()
        assert (killed / name).read_bytes() == there
        assert (with_two.folder / name).read_bytes() == there


def test_without_failures_it_is_the_study(case: LoadedScenario, tmp_path: Path) -> None:
    sound = {"failures.pick.probability": 0.0, "failures.place-down.probability": 0.0}
    sure = case.varied(sound)
    policies = ["asynchronous + shortcuts"]
    plain = studied(sure, tmp_path / "plain", 10, policies=policies)
    ours = studied(sure, tmp_path / "ours", 10, operate=True)
    assert set(ours.replications["versions"].to_pylist()) == {0}
    assert ours.replications.select(plain.replications.column_names) == (
        plain.replications
    )
    for name in ("tasks.parquet", "edges.parquet"):
        assert pq.read_table(ours.folder / name) == pq.read_table(plain.folder / name)


def test_robots_that_are_out_are_operated(plan: PlanResult, tmp_path: Path) -> None:
    case = plan.scenario.varied({"outages": [{"robot": "right", "at_s": 30.0}]})
    out = replace(plan, scenario=case)
    rows = studied(out, tmp_path / "out", 6, operate=True).replications.to_pylist()
    about = case.sections, plan.motions, plan.tpg, scenario_execution(case.sections)
    for k, row in enumerate(rows):
        done = operate(*about, seed=case.sections.seed, replication=k)
        assert row["robots_out"] == len(done.out) == 1
        assert row["outcome"] == done.record.outcome
        assert round(row["makespan_s"] * 1e9) == done.record.makespan_ns


@pytest.mark.parametrize(
    ("scenario", "options", "words"),
    [
        ("tower", {}, "planned in space and time at once"),
        ("kitting", {}, "machines"),
        ("cliff", {"policies": ["open-loop"]}, "'open-loop' cannot be planned anew"),
        ("cliff", {"vary": {"policy": ["sequential"]}}, "only asynchronous"),
        ("cliff", {"vary": {"robots": [1, 2]}}, "study each layout by itself"),
        ("cliff", {"operate": False, "failures": 0.1}, "give operate, too"),
    ],
)
def test_what_cannot_be_planned_anew_is_refused_before_anything_is_planned(
    scenario: str,
    options: dict[str, Any],
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(
        "twin.api.operations.plan_to_operate", lambda *_: pytest.fail("planned")
    )
    with pytest.raises(RequestError, match=words):
        twin.study(scenario, out=tmp_path / "out", **{"operate": True, **options})
    assert not (tmp_path / "out").exists()
