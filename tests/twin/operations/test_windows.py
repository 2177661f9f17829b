"""Windows of time between steps are kept, carried over and told of where plans are made anew."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import twin
from planning.tasks.task import Task, TaskKind, TimeWindow
from scheduling.graph.plan_files import load_plan, save_plan
from tests.twin.operations.operated import operated, planned, require_safe, tasks_of
from tests.twin.written import written
from twin.engine.engine import Simulator
from twin.engine.model_holds import with_model_holds
from twin.operations.operation import Operation
from twin.recorders.observers import MemoryRecorder
from twin.runs.windows import window_summary
from twin.trial.plan_result import PlanResult
from twin.trial.simulation import scenario_execution

TEXT = (Path(__file__).parents[3] / "scenarios" / "assembly" / "gluing.yaml").read_text(
    encoding="utf-8"
)

WINDOWS = {
    "block_a after glue_a": (3, "glue", 4, 3.0, 20.0),
    "block_b after glue_b": (6, "glue", 7, 3.0, 20.0),
    "bridge after block_a": (4, "place-down", 8, 60.0, None),
    "bridge after block_b": (7, "place-down", 8, 20.0, None),
}
"""Step and kind of what opens each window, the step that is due, least and greatest time [s]."""


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> PlanResult:
    return planned(written(tmp_path_factory.mktemp("gluing"), TEXT))


def failing(chance: float, **values: Any) -> dict[str, Any]:
    item = {"probability": chance, "retries": 0}
    skills = ("pick", "place-down", "glue", "look")
    return {**{f"failures.{skill}": item for skill in skills}, **values}


def span(done: Operation, task: Task) -> tuple[int, int]:
    """Return when a task began and ended [ns]."""
    k = done.tpg.chain_index[task.robot]
    nodes = np.flatnonzero(done.tpg.chains[k].task == task.index)
    return int(done.record.start_ns[k][nodes[0]]), int(done.record.end_ns[k][nodes[-1]])


def passed_ns(done: Operation, name: str) -> int | None:
    """Return what passed in a window, read from the steps and not from the windows of the graph."""
    opener, kind, due, _, _ = WINDOWS[name]
    opened = [t for t in done.tpg.tasks if (t.step, t.kind) == (opener, kind)]
    placed = [t for t in done.tpg.tasks if (t.step, t.kind) == (due, "place-down")]
    if not opened or not placed:
        return None
    return span(done, placed[-1])[0] - span(done, opened[-1])[1]


def require_windows(done: Operation) -> None:
    require_safe(done.tpg)
    told = {row["window"]: row for row in window_summary(done.tpg, done.record)}
    for name, (*_, least, most) in WINDOWS.items():
        passed = passed_ns(done, name)
        assert (passed is not None) == (name in told)
        if passed is not None:
            assert passed >= least * 1e9
            assert told[name]["passed_s"] == pytest.approx(passed / 1e9)
            assert told[name]["within_s"] == most
            late = None if most is None else passed > most * 1e9
            assert told[name]["broken"] is late


@pytest.mark.parametrize("hold", [0.0, 0.95])
def test_without_failures_it_is_the_run(plan: PlanResult, hold: float) -> None:
    case, memory = plan.scenario.varied({"windows.hold": hold}), MemoryRecorder()
    model = scenario_execution(case.sections, case.folder)
    Simulator(with_model_holds(plan.tpg, model), model).run(seed=3, recorders=(memory,))
    done, events = operated(plan, 3, **{"windows.hold": hold})
    assert events == memory.events
    require_windows(done)


@pytest.mark.nightly
@settings(max_examples=2, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    hold=st.sampled_from([0.0, 0.8]),
    planning_s=st.sampled_from([0.0, 1.0, 30.0]),
)
def test_whatever_fails_least_times_pass_and_all_windows_are_told(
    plan: PlanResult, seed: int, hold: float, planning_s: float
) -> None:
    values = {
        "windows.hold": hold,
        "recovery.again": 100,
        "recovery.planning_s": planning_s,
    }
    done, events = operated(plan, seed, **failing(0.3, **values))
    assert done.record.outcome == "completed"
    assert len(done.tpg.windows) == len(WINDOWS)
    require_windows(done)
    broken = [row for row in window_summary(done.tpg, done.record) if row["broken"]]
    told = {e.detail.split(":")[0] for e in events if e.kind == "window_broken"}
    assert told == {row["window"] for row in broken}
    # A least time passes once after each step that opens a window, whatever is planned anew.
    lags = [t.robot for t in done.tpg.tasks if t.kind == TaskKind.LAG]
    assert len(lags) == len(set(lags)) == 4


def test_windows_of_what_is_given_up_are_none(plan: PlanResult) -> None:
    gone = {"failures.pick": {"probability": 0.0, "parts": {"block_a": 1.0}}}
    done, _ = operated(plan, 0, **gone, **{"recovery.again": 0})
    assert 4 in done.given_up
    require_windows(done)
    assert {window.words for window in done.tpg.windows} == {"block_b after glue_b"}


def test_what_opens_a_window_is_held_back_after_a_failure_too(plan: PlanResult) -> None:
    """The camera fails before the glue is on, so that the later step comes later."""
    for seed in (3,):
        late = {}
        for hold in (0.0, 0.95):
            looks = {"failures.look": {"probability": 0.4, "retries": 0}}
            done, _ = operated(plan, seed, **looks, **{"windows.hold": hold})
            assert done.versions
            rows = window_summary(done.tpg, done.record)
            late[hold] = [row["window"] for row in rows if row["broken"]]
        assert late[0.0]
        assert not late[0.95]


def test_what_is_done_again_opens_its_window_again(tmp_path: Path) -> None:
    inspecting = (
        "inspecting: {duration: {kind: uniform, low_s: 1, high_s: 2}, distance_m: 0.1}"
    )
    step = (
        "    - {process: inspecting, at: {part: plate, frame: spot_a}, robots: [left],"
        " after: [{step: glue_a, at_least_s: 5}]}\n"
    )
    file = written(
        tmp_path,
        TEXT,
        ("  processes:\n", f"  processes:\n    {inspecting}\n"),
        ("    - {place: block_a", step + "    - {place: block_a"),
    )
    plan = planned(file)
    reject = {"probability": 0.6, "retries": 0, "then": "rework"}
    again = 0
    for seed in (4,):
        done, _ = operated(
            plan, seed, **{"failures.inspecting": reject, "recovery.again": 100}
        )
        assert done.record.outcome == "completed"
        require_safe(done.tpg)
        glued = [
            span(done, t) for t in done.tpg.tasks if (t.step, t.kind) == (3, "glue")
        ]
        looked = [
            span(done, t)
            for t in done.tpg.tasks
            if t.step == 4 and t.kind in (TaskKind.FAILED, "inspecting")
        ]
        again += len(glued) - 1
        assert len(glued) == len(looked)
        for (_, ended), (begun, _) in zip(glued, looked, strict=True):
            assert begun >= ended + 5e9
    assert again


@pytest.mark.parametrize(
    "at", ["glue_a", pytest.param("block_b", marks=pytest.mark.nightly)]
)
def test_a_window_that_is_open_goes_on_in_what_is_left(
    plan: PlanResult, tmp_path: Path, at: str
) -> None:
    run = twin.run(plan, out=tmp_path / "run", recording=False, audit=False)
    tpg, record = run.tpg, run.node_times_ns
    name = {"glue_a": "block_a after glue_a", "block_b": "bridge after block_b"}[at]
    (window,) = (w for w in tpg.windows if w.words == name)
    opener = tpg.tasks[window.done]
    k = tpg.chain_index[opener.robot]
    nodes = np.flatnonzero(tpg.chains[k].task == opener.index)
    ended_s = record[k][1][nodes[-1]] / 1e9
    left = twin.plan(world=f"{run.files}@{ended_s + 0.2}")
    require_safe(left.tpg)
    (other,) = (w for w in left.tpg.windows if w.words == name)
    assert (other.begun, other.done) == (TimeWindow.EARLIER, TimeWindow.EARLIER)
    assert other.ago >= 0.2
    # Others are as they were, and what is over is left out.
    assert {w.words for w in left.tpg.windows} <= WINDOWS.keys()
    save_plan(left.tpg, tmp_path)
    assert load_plan(tmp_path).windows == left.tpg.windows
    went = twin.run(left, out=tmp_path / "went", recording=False)
    assert went.outcome == "completed"
    assert went.summary["audit"]["violations"] == []
    (row,) = (row for row in went.summary["windows"] if row["window"] == name)
    due = went.tpg.tasks[other.due]
    k = went.tpg.chain_index[due.robot]
    first = int(np.flatnonzero(went.tpg.chains[k].task == due.index)[0])
    begun_s = went.node_times_ns[k][0][first] / 1e9
    assert row["passed_s"] == pytest.approx(other.ago + begun_s)
    assert row["passed_s"] >= other.least - 1e-9
    assert not tasks_of(went, TaskKind.LEFT_OUT)
