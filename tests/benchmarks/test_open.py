"""The open benchmark: entries hand their plans in, planners of others too, and tables come out twice the same."""

import json
from pathlib import Path

import pytest

from benchmarks.open.__main__ import Row
from benchmarks.open.entries import ENTRIES, by_the_clock, one_at_a_time, own_plan
from benchmarks.open.planners import klampt_path, ompl_path
from benchmarks.open.tasks import TASKS, chosen
from tests.twin.written import written
from twin.judge.judge import Judgement, judge
from twin.runs.policies import ASYNCHRONOUS, SEQUENTIAL, SYNCHRONOUS
from twin.trial.loaded_scenario import LoadedScenario, load

SCENARIO = """\
version: 1
name: post
cell:
  robots:
    - {name: west, model: tower-crane, base: {xyz_m: [-3.5, 0, 0]}, home_rad_or_m: [1.5708, 2.0, 0.0, 0.0]}
    - {name: east, model: tower-crane, base: {xyz_m: [3.5, 0, 0], rpy_deg: [0, 0, 180]}, home_rad_or_m: [1.5708, 2.0, 0.0, 0.0]}
  fixtures:
    - {name: table, size_m: [0.8, 0.8, 1.0], pose: {xyz_m: [0, 0, 0.5]}}
    - {name: post, size_m: [0.2, 0.2, 2.2], pose: {xyz_m: [-1.05, 1.6, 1.1]}}
    - {name: west_stand, size_m: [0.8, 0.8, 1.0], pose: {xyz_m: [-3.5, 3.0, 0.5]}}
    - {name: east_stand, size_m: [0.8, 0.8, 1.0], pose: {xyz_m: [3.5, -3.0, 0.5]}}
assembly:
  kind: assembly
  parts:
    - {name: lower, size_m: [0.4, 0.4, 0.2], start: {xyz_m: [-3.5, 3.0, 1.1]}, goal: {xyz_m: [0, 0, 1.1]}}
    - {name: upper, size_m: [0.4, 0.4, 0.2], start: {xyz_m: [3.5, -3.0, 1.1]}, goal: {xyz_m: [0, 0, 1.3]}}
  steps:
    - {place: lower}
    - {place: upper, after: [lower]}
  grips: {suction: true}
planning: {speed_model: joint}
execution:
  skills:
    pick: {kind: uniform, low_s: 4.0, high_s: 6.0}
    place-down: {kind: uniform, low_s: 4.0, high_s: 6.0}
"""


@pytest.fixture(scope="module")
def task(tmp_path_factory: pytest.TempPathFactory) -> LoadedScenario:
    return load(written(tmp_path_factory.mktemp("task"), SCENARIO))


def told(
    content: dict[str, object], task: LoadedScenario, folder: Path, seeds: int = 0
) -> Judgement:
    file = folder / "plan.json"
    file.write_text(json.dumps(content), encoding="utf-8")
    return judge(file, task, seeds=seeds)


def test_every_task_is_there() -> None:
    assert len({task.load().name for task in TASKS}) == len(TASKS) >= 9
    assert {task.size for task in TASKS} == {"small", "middle", "large"}
    assert [task.name for task in chosen(["tower"], [])] == ["tower"]
    assert len(ENTRIES) >= 6


@pytest.mark.parametrize("policy", [SYNCHRONOUS, ASYNCHRONOUS])
def test_our_policies_enter_as_anybody_does(
    policy: str, task: LoadedScenario, tmp_path: Path
) -> None:
    content = own_plan(task, policy)
    once, again = (told(content, task, tmp_path, seeds=1) for _ in range(2))
    assert once.clean
    assert Row("post", policy, once).cells() == Row("post", policy, again).cells()


def test_a_fixed_clock_has_its_margin(task: LoadedScenario, tmp_path: Path) -> None:
    tight, slow = (told(by_the_clock(task, m), task, tmp_path) for m in (0.0, 0.25))
    assert not tight.findings
    assert not slow.findings
    assert slow.planned_s == pytest.approx(1.25 * tight.planned_s)
    assert not slow.waits


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("finder", "package"), [(ompl_path, "ompl"), (klampt_path, "klampt")]
)
def test_a_planner_of_others_enters(
    finder: object, package: str, task: LoadedScenario, tmp_path: Path
) -> None:
    pytest.importorskip(package)
    content = one_at_a_time(task, finder, package)  # type: ignore[arg-type]
    found = told(content, task, tmp_path)
    assert found.findings == ()
    ours = told(own_plan(task, SEQUENTIAL), task, tmp_path)
    assert found.planned_s == pytest.approx(ours.planned_s, rel=0.5)
    rows = [
        len(motion["q"])
        for robot in content["robots"].values()
        for motion in robot["motions"]
        if "skill" not in motion
    ]
    assert max(rows) > 2  # it had to go around the post


@pytest.mark.nightly
@pytest.mark.expensive
def test_a_line_with_feeders_and_a_conveyor_enters(tmp_path: Path) -> None:
    kits = load("kitting").varied({"assembly.products.count": 3})
    found = told(own_plan(kits, ASYNCHRONOUS), kits, tmp_path, seeds=1)
    assert found.clean
