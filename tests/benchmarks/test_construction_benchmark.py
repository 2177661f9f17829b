"""The benchmark of constructions: what is measured in which order, what is kept, what is said."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.construction import experiments as construction
from benchmarks.construction.case import case_scenario
from benchmarks.construction.paper import DURATIONS
from benchmarks.construction.report import summary, write_report
from benchmarks.construction.rows import best_baseline
from benchmarks.construction.schedule import CARRY, DRIVE, HOME, schedule
from benchmarks.store import RowStore
from planning.construction.planner import ConstructionPlan
from planning.construction.problem.problem import ConstructionProblem
from planning.construction.world.fixed_world import BuildState, FixedWorld, PlannedTask
from planning.construction.world.timeline import RobotTimeline
from planning.tasks.task import Handling
from planning.transforms import identity
from tests.planning.construction.toy_teams import placed, slider, team


def method_row(model: str, robots: int, seed: int, makespan: float) -> dict[str, Any]:
    seconds = {"checks": 1.0, "keyframes": 2.0, "path": 2.0, "postprocessing": 1.0}
    seconds |= {"other": 0.5, "total": 6.5}
    return {
        "what": "method",
        "model": model,
        "robots": robots,
        "seed": seed,
        "ok": True,
        "parts": 15,
        "longest_chain": 15,
        "chain_s": 50.0,
        "makespan_s": makespan,
        "rewound": 0,
        "failures": 0,
        "cpu_s": seconds,
        "wall_s": seconds,
        "load": 0.5,
        "fine": {"faults": [], "least_robots_m": 0.004, "least_others_m": 0.001},
        "tpg": {
            "planned_s": makespan + 5,
            "executed_s": makespan + 4,
            "nodes": 9,
            "edges": 3,
            "cpu_s": 1.0,
        },
        "runs": [{"outcome": "completed", "violations": [], "stalls": 0}],
        "schedule": [["robot1", DRIVE, 0.0, 3.0, 1], ["robot1", "pick", 3.0, 5.0, 1]],
        "machine": "here",
        "commit": "abc",
        "date": "2026-01-01",
    }


def fixed_row(
    robots: int, seed: int, duration: float, makespan: float
) -> dict[str, Any]:
    row = method_row("tower", robots, seed, makespan)
    spent = {"keyframes": 10.0, "path": 12.0, "other": 0.0, "total": 22.0}
    return row | {"what": "baseline", "duration_s": duration, "cpu_s": spent}


def test_growth_is_told_from_one_robot_on_and_from_five_on() -> None:
    rows = [method_row("tower", m, 0, 90.0) for m in (1, 5, 10)]
    for row, total in zip(rows, (2.0, 4.0, 6.0), strict=True):
        row["cpu_s"] = row["cpu_s"] | {"total": total}
    lines = [line for line in summary(rows) if "Growth" in line]
    assert lines == [
        "- Growth of computation: tower 3.0 times from 1 to 10 robots, 1.5 times from 5 to 10"
        " robots."
    ]
    lines = [line for line in summary(rows[1:]) if "Growth" in line]
    assert lines == ["- Growth of computation: tower 1.5 times from 5 to 10 robots."]


def test_the_first_seed_of_everything_comes_first() -> None:
    cases = construction.all_cases(["tower", "pavilion"], [], None)
    seeds = [case.seed for case in cases]
    assert seeds == sorted(seeds)
    assert len(set(cases)) == len(cases)
    assert {c.robots for c in cases if c.model == "pavilion"} == {1, 5, 8}
    assert max(c.seed for c in cases if c.model == "pavilion") == 9
    assert max(c.seed for c in cases if c.model == "tower") == 9
    first = [
        c.duration for c in cases if (c.model, c.robots, c.seed) == ("tower", 5, 0)
    ]
    assert first == [None, *DURATIONS]
    later = [
        c.duration for c in cases if (c.model, c.robots, c.seed) == ("tower", 5, 3)
    ]
    assert later == [None, "best"]


def test_a_case_is_the_shipped_scenario_with_another_team() -> None:
    scenario = case_scenario("wall", 3, 7)
    assert scenario.seed == 7
    assert [robot.name for robot in scenario.cell.robots] == [
        "robot1",
        "robot2",
        "robot3",
    ]
    mixed = case_scenario("gatehouse", 12, 7)  # the crane and both arms stay
    assert len(mixed.cell.robots) == 12


def test_rows_of_another_program_or_machine_do_not_count_unless_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program = tmp_path / "root"
    (program / "planning").mkdir(parents=True)
    source = program / "planning" / "a.py"
    source.write_text("a = 1\n")
    store = RowStore(tmp_path / "rows", program)
    kept = store.save("tower-1-0-method", {"ok": True})
    assert store.load("tower-1-0-method") == kept
    assert RowStore(tmp_path / "rows", program).load("tower-1-0-method") == kept
    assert kept["date"]
    assert store.load("tower-2-0-method") is None
    with monkeypatch.context() as elsewhere:
        elsewhere.setattr("benchmarks.store.machine_line", lambda: "there")
        assert RowStore(tmp_path / "rows", program).load("tower-1-0-method") is None
    source.write_text("a = 2\n")
    later = RowStore(tmp_path / "rows", program)
    assert later.load("tower-1-0-method") is None
    assert list(RowStore(tmp_path / "rows", program, any_version=True).rows()) == [kept]


def test_an_interrupted_benchmark_goes_on_and_reports_what_it_has(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []

    def measured(case: construction.Case, *_: object) -> dict[str, Any]:
        if len(asked) == 4:
            raise KeyboardInterrupt
        asked.append(case.key)
        if case.duration is None:
            return method_row("tower", case.robots, case.seed, 100.0 / case.robots)
        assert isinstance(case.duration, float)
        return fixed_row(case.robots, case.seed, case.duration, 70.0 - case.duration)

    monkeypatch.setattr(construction, "_measure", measured)
    monkeypatch.setattr(construction, "warm_up", lambda: None)
    monkeypatch.setattr(construction, "ROOT", tmp_path)
    arguments = ["--models", "tower", "--robots", "1", "5", "--seeds", "2", "--quiet"]
    arguments += ["--out", str(tmp_path / "out")]
    with pytest.raises(KeyboardInterrupt):
        construction.main(arguments)
    text = (tmp_path / "out" / "construction.md").read_text()
    assert "| tower | 15 | 15 | 1 | 1 | 100.0 | **1.00** |" in text
    before = list(asked)
    asked.clear()
    while True:
        try:
            assert construction.main(arguments) == 0
            break
        except KeyboardInterrupt:
            before += asked
            asked.clear()
    before += asked
    assert len(before) == len(set(before)) == 2 * 6 + 2 * 2
    # The longest T gave the shortest plan of the first seed.
    assert {key for key in before if "-1-fixed" in key} == {
        "tower-1-1-fixed-8.0",
        "tower-5-1-fixed-8.0",
    }
    text = (tmp_path / "out" / "construction.md").read_text()
    assert "| tower | 15 | 15 | 5 | 2 | 20.0 ± 0.0 | **5.00** | 1.00 | 2.0 |" in text


def test_the_report_says_what_is_missing_and_compares_equal_seeds(
    tmp_path: Path,
) -> None:
    rows = [method_row("tower", 1, k, 200.0) for k in range(3)]
    rows += [method_row("tower", 10, k, 60.0 + k) for k in range(3)]
    rows += [fixed_row(10, 0, t, 60.0 + 3 * t) for t in (8.0, 4.0)]
    rows += [fixed_row(10, 1, 4.0, 74.0)]
    gone = {
        "ok": False,
        "reason": "no way was found to place c1",
        "cpu_s": {"total": 77.0},
    }
    rows.append({**method_row("pavilion", 5, 0, 0.0), **gone})
    best = best_baseline(rows, "tower", 10)
    assert best is not None
    assert best[0] == 4.0
    assert len(best[1]) == 2
    text = write_report(tmp_path, rows).read_text()
    # 11.0 ... of the method with the seeds that the baseline has: 60 and 61; 22 s against 5.5 s.
    row = "| tower | 10 | 2 | 4 | 73.0 ± 1.4 | 60.5 ± 0.7 | **1.21** | 22.0 ± 0.0 | 5.5 ± 0.0 | **4.00** |"
    assert row in text
    assert "pavilion, 5 robots, seed 0: no way was found to place c1 (77 s" in text
    assert "| tower | 10 | 3 |" in text  # a row says how many seeds it has
    assert "5.8 %" in text  # 6.5 s of the paper's 112.9 s
    assert "Tower with 10 robots: 4.0 times as quick" in text
    assert "**Not planned**: 1" in text
    kept = json.loads((tmp_path / "construction.json").read_text())["cases"]
    assert len(kept) == len(rows)
    for name in ("speed-up", "time", "tower"):
        assert (tmp_path / f"construction-{name}.png").stat().st_size > 5000
    assert not (tmp_path / "construction-pavilion.png").exists()


def test_a_schedule_tells_carrying_driving_and_waiting() -> None:
    cell = team([placed("a", slider(), (0.0, 0.0))])
    time = np.array([0.0, 2.0, 5.0, 6.0, 8.0, 9.0, 11.0])
    x = np.array([0.0, 1.0, 1.0, 1.0, 2.0, 2.0, 0.0])
    line = RobotTimeline("a", time, np.stack([x, 0 * x], axis=1))

    def skill(kind: str, start: float, holder: str | None) -> PlannedTask:
        times, stand = start + np.array([0.0, 0.5, 1.0]), np.zeros((3, 2))
        handled = (Handling("p", 1, holder, identity()),)
        return PlannedTask("a", kind, times, stand, 1, kind, "p", handled)

    pick, place = skill("pick", 5.0, "a"), skill("place-down", 8.0, None)
    world = FixedWorld(cell).with_robot(line)
    problem = ConstructionProblem(cell, (), None)  # type: ignore[arg-type]
    plan = ConstructionPlan(problem, BuildState(world, (pick, place)), {}, {})
    assert [tuple(span)[1:4] for span in schedule(plan)] == [
        (DRIVE, 0.0, 2.0),
        ("pick", 5.0, 6.0),
        (CARRY, 6.0, 8.0),
        ("place-down", 8.0, 9.0),
        (HOME, 9.0, 11.0),
    ]
