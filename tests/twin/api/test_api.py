"""A scenario by Python, from its file to its replay, against what the program writes."""

import json
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

import twin
from planning.errors import OutputError, RequestError, ScenarioError
from tests.shipped_runs import ShippedRuns

FILE = Path(__file__).parents[3] / "scenarios/multi_arm/rearrangement.yaml"


@pytest.fixture(scope="module")
def plan(shipped: ShippedRuns) -> twin.PlanResult:
    planned = shipped("multi_arm/rearrangement").planned
    return replace(planned, scenario=twin.load(FILE))


@pytest.fixture(scope="module")
def simulated(plan: twin.PlanResult) -> twin.RunResult:
    return twin.simulate(plan)


@pytest.fixture(scope="module")
def written(plan: twin.PlanResult, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("api") / "run"
    done = twin.run(plan, out=folder, recording=False)
    assert done.folder == folder
    return folder


def test_a_scenario_tells_what_is_in_it() -> None:
    found = twin.load(str(FILE))
    assert found.name == "rearrangement"
    assert found.robots == ("west", "north", "south")
    assert found.steps == 3
    assert twin.load(found) is found
    assert "rearrangement" in found._repr_html_()
    words = "<scenario 'rearrangement' of kind assembly: 3 robots, 3 steps, 3 parts>"
    assert str(found) == words


def test_a_scenario_with_other_values_is_another_one() -> None:
    found = twin.load(FILE)
    other = found.varied({"cell.robots.north.base.xyz_m.2": 0.05, "seed": 4})
    assert other.sections.cell.robots[1].base.xyz_m[2] == 0.05
    assert found.sections.cell.robots[1].base.xyz_m[2] == 0.0
    with pytest.raises(ScenarioError, match="already taken"):
        found.varied({"cell.robots.north.name": "south"})
    with pytest.raises(ScenarioError, match="unknown robot 'nobody'"):
        found.varied(
            {"emergency_stops": [{"at_s": 1.0, "duration_s": 1.0, "robot": "nobody"}]}
        )


def test_a_check_finds_the_same_as_the_program(tmp_path: Path) -> None:
    found = twin.check(FILE)
    assert found.ok
    assert found.errors == ()
    (row,) = found.findings.to_pylist()
    assert row["level"] == "warning"
    assert f"line {row['line']}: {row['message']}" == found.warnings[0]
    bad = found.scenario.varied({"cell.robots.north.base.xyz_m.0": 0.0})
    bad = bad.varied({"cell.robots.north.base.xyz_m.1": 0.0})
    assert not twin.check(bad).ok
    with pytest.raises(ScenarioError):
        twin.plan(bad)
    assert found.draw(tmp_path).stat().st_size > 10_000


def test_a_simulation_is_the_run_that_the_program_writes(
    simulated: twin.RunResult, written: Path
) -> None:
    summary = json.loads((written / "summary.json").read_text())
    assert simulated.makespan_s == summary["makespan_s"]
    assert simulated.wait_s == summary["wait_s"]
    assert simulated.policy == summary["policy"]
    # The program was asked for no audit, which it lists among the checks that were off.
    files = ("audit", "files", "checks_off")
    told = {k: v for k, v in simulated.summary.items() if k not in files}
    read = {k: v for k, v in summary.items() if k not in files}
    # The shipped plan was made without looking at warnings.
    assert {**told, "warnings": []} == {**read, "warnings": []}
    assert simulated.trajectory.equals(pq.read_table(written / "trajectory.parquet"))
    assert simulated.objects.equals(pq.read_table(written / "objects.parquet"))
    lines = (written / "events.jsonl").read_text().splitlines()
    assert simulated.events.num_rows == len(lines)


def test_a_run_is_read_as_it_was(written: Path, simulated: twin.RunResult) -> None:
    found = twin.read_run(written)
    assert found.passed
    assert found.makespan_s == simulated.makespan_s
    assert found.events.equals(simulated.events)
    assert found.activities.equals(simulated.activities)
    assert found.trajectory.equals(simulated.trajectory)
    assert twin.simulate(found.plan).history == simulated.history
    assert "<img" in found._repr_html_()
    with pytest.raises(OutputError, match="this is no run"):
        twin.read_run(written / "nowhere")


def test_activities_fill_the_time_of_each_robot(simulated: twin.RunResult) -> None:
    rows = simulated.activities.to_pylist()
    for robot, waited in simulated.wait_s.items():
        lane = [row for row in rows if row["robot"] == robot]
        assert all(
            a["end_s"] == b["start_s"] for a, b in zip(lane, lane[1:], strict=False)
        )
        waits = sum(r["end_s"] - r["start_s"] for r in lane if r["state"] == "waiting")
        assert waits == pytest.approx(waited, abs=1e-6)
    assert max(row["end_s"] for row in rows) == simulated.makespan_s


def test_another_seed_and_other_values_need_no_other_plan(
    plan: twin.PlanResult,
) -> None:
    first, second = twin.simulate(plan, seed=5), twin.simulate(plan, seed=5)
    assert first.history == second.history
    assert first.seed == 5
    assert first.makespan_s != twin.simulate(plan).makespan_s
    alone = twin.simulate(plan, policy="sequential")
    slow = twin.simulate(plan, {"skills.pick.scale": 2})
    assert alone.makespan_s > first.makespan_s
    assert slow.makespan_s > twin.simulate(plan).makespan_s
    with pytest.raises(RequestError, match="planning is not that of the plan"):
        twin.simulate(plan, {"planning.speed_rad_s": 2})
    with pytest.raises(ScenarioError, match="there is no 'eager'"):
        twin.simulate(plan, policy="eager")


def test_the_audit_of_a_simulation_is_that_of_the_run(
    simulated: twin.RunResult, written: Path
) -> None:
    found, again = twin.audit(simulated), twin.audit(written)
    assert found.clean
    assert found.violations.num_rows == 0
    assert found.min_distance_m == again.min_distance_m
    summary = json.loads((written / "summary.json").read_text())
    assert found.report.content() == summary["audit"]


def test_an_audit_tells_what_it_finds(plan: twin.PlanResult) -> None:
    # Nobody waits for anybody: with a skill that takes three times as long they meet.
    late = twin.simulate(plan, {"skills.pick.scale": 3}, policy="open-loop")
    found = twin.audit(late)
    assert not found.clean
    assert found.violations.num_rows == len(found.report.violations)
    assert found.violations.column("kind")[0].as_py() in found._repr_html_()


@pytest.mark.nightly
def test_a_study_has_a_row_a_policy_and_variant(
    plan: twin.PlanResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = twin.study(
        plan,
        {"skills.pick.scale": [1, 2]},
        replications=30,
        workers=0,
        out=tmp_path / "study",
    )
    cells = found.cells.to_pylist()
    assert [cell["skills.pick.scale"] for cell in cells] == [1, 1, 2, 2]
    rows = found.replications
    assert rows.num_rows == 4 * 30
    for cell in cells:
        mine = [
            row["makespan_s"]
            for row in rows.to_pylist()
            if row["policy"] == cell["policy"]
            and row["skills.pick.scale"] == cell["skills.pick.scale"]
        ]
        assert np.mean(mine) == pytest.approx(cell["makespan_s"])
    assert found.report.is_file()
    assert found.tasks.num_rows == 4 * len(plan.tpg.tasks)
    # The report is there, and as long to draw again.
    monkeypatch.setattr(
        import_module("twin.studies.api"), "write_report", lambda result, progress: None
    )
    again = twin.resume_study(found.folder, FILE, workers=0)
    assert again.summary == found.summary
    with pytest.raises(RequestError, match="holds a study of scenario"):
        twin.resume_study(found.folder, FILE.with_name("assembly.yaml"))


def test_a_replay_needs_no_folder(simulated: twin.RunResult, tmp_path: Path) -> None:
    (file,) = twin.replay(simulated, out=tmp_path / "run.rrd")
    assert file.stat().st_size > 10_000
    (copy,) = twin.replay(file, out=tmp_path / "copy.rrd")
    assert copy.read_bytes() == file.read_bytes()
    with pytest.raises(RequestError, match="say where pictures go"):
        twin.replay(simulated, stills=[1.0])
    with pytest.raises(OutputError, match="no such file or folder"):
        twin.replay(tmp_path / "nothing")


def test_a_plan_tells_its_tasks_and_is_kept(
    plan: twin.PlanResult, tmp_path: Path
) -> None:
    assert plan.makespan_s > 0
    rows = plan.tasks.to_pylist()
    assert [row["task"] for row in rows] == list(range(len(rows)))
    assert {row["robot"] for row in rows} <= set(plan.scenario.robots)
    assert f"{plan.makespan_s:.2f} s" in plan._repr_html_()
    folder = plan.save(tmp_path / "plan")
    kept = twin.read_plan(folder, FILE)
    assert kept.makespan_s == plan.makespan_s
    assert twin.simulate(kept).history == twin.simulate(plan).history
