"""A study in which what fails is planned anew is so many operations of the cell, one by one."""

import shutil
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from importlib import import_module
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

import twin
from planning.errors import RequestError
from tests.twin.operations.operated import FEW, STACK
from twin.operations.operation import Operation, operate
from twin.studies.api import Study
from twin.studies.folder import BLOCKS, PREVENTED, REPLICATIONS, SUMMARY
from twin.studies.operated_figures import prevented_makespans_s
from twin.studies.replications import runner
from twin.studies.replications.block_results import cell_blocks
from twin.trial.loaded_scenario import LoadedScenario, load
from twin.trial.plan_result import PlanResult
from twin.trial.planning import plan_scenario
from twin.trial.simulation import scenario_execution

COUNT, FIRST = 24, 14
"""Replications of the study, and the first of those that are operated one by one."""

OFTEN = {
    "failures.pick": {"probability": 0.05, "retries": 1, "loses": 0.3},
    "failures.place-down": {"probability": 0.3, "retries": 1, "loses": 0.3},
    "recovery.again": 1,
}


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> LoadedScenario:
    file = tmp_path_factory.mktemp("stack") / "stack.yaml"
    file.write_text(STACK)
    return load(file).varied({**FEW, **OFTEN})


@pytest.fixture(scope="module")
def plan(case: LoadedScenario) -> PlanResult:
    return plan_scenario(case, keep=True)


@pytest.fixture(scope="module", autouse=True)
def _of_several_blocks() -> Iterator[None]:
    """Studies are of several blocks, as longer ones, and draw nothing."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            import_module("twin.studies.api"),
            "write_report",
            lambda result, progress: None,
        )
        patch.setattr(runner, "EVENTS_BLOCK", 8)
        yield


def studied(
    plan: PlanResult | LoadedScenario, out: Path, count: int = COUNT, **options: Any
) -> Study:
    return twin.study(plan, replications=count, out=out, **options)


def operated(
    plan: PlanResult, k: int, changes: dict[str, Any] | None = None
) -> Operation:
    """Operate the cell once, where skills fail as of a scenario with other values."""
    case = plan.scenario.sections
    model = scenario_execution(plan.scenario.varied(changes or {}).sections)
    about = case, plan.motions, plan.tpg, model
    return operate(*about, seed=case.seed, replication=k)


@pytest.fixture(scope="module")
def study(plan: PlanResult, tmp_path_factory: pytest.TempPathFactory) -> Study:
    return studied(plan, tmp_path_factory.mktemp("study") / "out", operate=True)


@pytest.fixture(scope="module")
def operations(plan: PlanResult) -> list[Operation]:
    return [operated(plan, k) for k in range(FIRST, COUNT)]


def test_it_is_one_operation_after_the_other(
    study: Study, operations: list[Operation]
) -> None:
    rows = study.replications.to_pylist()[FIRST:]
    assert any(done.given_up for done in operations)
    assert 2 < sum(bool(done.versions) for done in operations) < COUNT - FIRST
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


@pytest.mark.nightly
def test_what_is_gone_on_with_makes_the_same_files(
    study: Study, tmp_path: Path
) -> None:
    killed = tmp_path / "killed"
    shutil.copytree(study.folder, killed)
    for name in (REPLICATIONS, SUMMARY, f"{BLOCKS}/0-8-8.npz"):
        (killed / name).unlink()
    assert len(list((killed / BLOCKS).glob("*.npz"))) == COUNT // 8 - 1
    (killed / PREVENTED / "1-16-8.npz").unlink()
    twin.resume_study(killed)
    for file in study.folder.rglob("*"):
        if file.is_file() and not file.name.startswith("manifest"):
            again = killed / file.relative_to(study.folder)
            assert again.read_bytes() == file.read_bytes()


@pytest.mark.nightly
def test_other_workers_make_the_same_files(
    study: Study, plan: PlanResult, tmp_path: Path
) -> None:
    ours = studied(plan, tmp_path / "two", 16, operate=True, workers=2)
    for folder, count in ((BLOCKS, 2), (PREVENTED, 4)):
        files = list((ours.folder / folder).glob("*.npz"))
        assert len(files) == count
        for file in files:
            there = study.folder / folder / file.name
            assert there.read_bytes() == file.read_bytes()


def test_what_prevention_gains_is_found_by_operating_all_without_the_failures(
    study: Study, plan: PlanResult
) -> None:
    """Replications in which the skill did not fail are not computed again, and need not be."""
    blocks, count = study.folder / BLOCKS, 8
    skills = sorted(plan.scenario.sections.execution.failures)
    assert skills == ["pick", "place-down"]
    same = 0
    for place, skill in enumerate(skills):
        less = {f"failures.{skill}.probability": 0.0}
        found = prevented_makespans_s(blocks, 0, study.folder / PREVENTED, place)
        assert len(found) == COUNT
        for k in range(count):
            done = operated(plan, k, less).record
            whole = done.outcome == "completed"
            assert np.isfinite(found[k]) == whole
            assert not whole or round(found[k] * 1e9) == done.makespan_ns
        for own in cell_blocks(study.folder / PREVENTED, place):
            same += int(np.count_nonzero(own.rows.outcome == "same"))
    assert same
    prevented = study.summary["cells"][0]["operated"]["prevented"]
    assert [item["skill"] for item in prevented] == ["place-down", "pick"]
    assert prevented[0]["sooner_s"]["low"] > 0.0


@pytest.mark.nightly
def test_failures_with_a_part_are_prevented_by_themselves(
    plan: PlanResult, tmp_path: Path
) -> None:
    part = next(t.object for t in plan.tpg.tasks if t.kind == "place-down")
    key = "failures.place-down"
    item = {"probability": 0.05, "retries": 0}
    case = plan.scenario.varied({key: {**item, "parts": {part: 0.6}}})
    changed = replace(plan, scenario=case)
    ours = studied(changed, tmp_path / "out", 6, operate=True)
    prevented = ours.summary["cells"][0]["operated"]["prevented"]
    pairs = {(own["skill"], own["part"]) for own in prevented}
    assert pairs == {("pick", ""), ("place-down", ""), ("place-down", part)}
    found = prevented_makespans_s(ours.folder / BLOCKS, 0, ours.folder / PREVENTED, 2)
    for k, makespan_s in enumerate(found):
        record = operated(changed, k, {key: item}).record
        assert round(makespan_s * 1e9) == record.makespan_ns


def test_the_summary_counts_what_is_in_the_rows(study: Study) -> None:
    rows = study.replications.to_pylist()
    told = study.summary["cells"][0]["operated"]
    gave_up = [row["given_up"].split() for row in rows]
    assert told["gave_up"]["estimate"] == sum(map(bool, gave_up)) / COUNT
    assert told["given_up"] == dict(sorted(Counter(chain(*gave_up)).items()))
    assert told["completed"]["estimate"] == 1.0 - told["gave_up"]["estimate"]
    for rung, found in told["recoveries"].items():
        assert found["estimate"] == pytest.approx(sum(r[rung] for r in rows) / COUNT)
    regrets = [row["regret_s"] for row in rows if row["outcome"] == "completed"]
    assert told["regret_s"]["estimate"] == pytest.approx(sum(regrets) / len(regrets))
    assert all(
        (r["regret_s"] == 0.0) or r["versions"] for r in rows if not r["given_up"]
    )


@pytest.mark.nightly
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


@pytest.mark.nightly
def test_robots_that_are_out_are_operated(plan: PlanResult, tmp_path: Path) -> None:
    case = plan.scenario.varied({"outages": [{"robot": "right", "at_s": 30.0}]})
    out = replace(plan, scenario=case)
    rows = studied(out, tmp_path / "out", 6, operate=True).replications.to_pylist()
    for k, row in enumerate(rows):
        done = operated(out, k)
        assert row["robots_out"] == len(done.out) == 1
        assert row["outcome"] == done.record.outcome
        assert round(row["makespan_s"] * 1e9) == done.record.makespan_ns


@pytest.mark.parametrize(
    ("scenario", "options", "words"),
    [
        ("cliff", {"policies": ["open-loop"]}, "'open-loop' cannot be replanned"),
        ("cliff", {"vary": {"policy": ["sequential"]}}, "only asynchronous"),
        ("cliff", {"vary": {"robots": [1, 2]}}, "study each layout by itself"),
        ("cliff", {"operate": False, "failures": 0.1}, "give operate, too"),
        ("cliff", {"vary": {"window": [{"steps": 4}]}}, "a plan of all steps"),
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
        import_module("twin.operations.api"),
        "plan_until_final",
        lambda *_, **__: pytest.fail("planned"),
    )
    with pytest.raises(RequestError, match=words):
        twin.study(scenario, out=tmp_path / "out", **{"operate": True, **options})
    assert not (tmp_path / "out").exists()
