"""Feeding stations from the scenario to the audit: there is always another brick, one at a time."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from planning.errors import PlanInvariantError
from planning.transforms import translation
from scheduling.build_tpg import build_tpg
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.graph.plan_files import load_plan, save_plan
from scheduling.verification.graph_structure import check_structure
from scheduling.verification.verify import verify_plan
from tests.twin.recorders.transform_chains import broken_chains
from tests.twin.scenarios.cells import GP4S, cell
from tests.twin.scenarios.executed import executed
from twin.audits.audit import Auditor, audit_run
from twin.audits.motion.executed import read_recording
from twin.exports.graphs import task_graph
from twin.runs.trajectory import object_placements
from twin.scenario.sections.scenario import Scenario
from twin.scenario.variations import apply_variation
from twin.trial.plan_result import PlanResult
from twin.trial.run_result import RunResult
from twin.verification.standing_states import audit_standing_states

SCENARIO = cell(
    "fence",
    GP4S,
    """\
  kind: lego
  plate: {pose: {xyz_m: [0.44, 0, 1.1145]}}
  stock:
    - {name: near, brick: 2x4, at: [8, 22, 1], station: true}
    - {name: far, brick: 2x4, at: [38, 22, 1], station: true}
    - {name: between, brick: 2x2, at: [23, 36, 1], station: true}
    - {name: spare, brick: 2x2, at: [27, 36, 1]}
  steps:
    - {brick: 2x4, at: [20, 16, 1], press: {side: 1, offset: 1}, stock: near}
    - {brick: 2x4, at: [26, 16, 1], press: {side: 4, offset: 1}, stock: far}
    - {brick: 2x2, at: [20, 22, 1], press: {side: 1, offset: 0}, stock: between}
    - {brick: 2x2, at: [26, 22, 1], press: {side: 4, offset: 0}, stock: between}
    - {brick: 2x4, at: [20, 16, 2], press: {side: 1, offset: 1}, stock: near}
    - {brick: 2x2, at: [26, 22, 2], press: {side: 4, offset: 0}, stock: between}
""",
    "{name: table, size_m: [0.6, 1.2, 0.02], pose: {xyz_m: [0.44, 0, 1.1045]}}",
)
COPIES = {"near": 3, "far": 2, "between": 4}


@pytest.fixture(scope="module")
def trial(planned: PlanResult, scenario: Scenario, file: Path) -> RunResult:
    return executed(scenario, planned.tpg, file.parent / "run", recording=True)


def test_one_more_brick_than_steps_is_made_and_only_the_first_is_there(
    planned: PlanResult,
) -> None:
    later = {o.name: o.later for o in planned.tpg.cell.objects}
    expected = {f"{s}.{k}": k > 1 for s, n in COPIES.items() for k in range(1, n + 1)}
    assert later == {**expected, "spare": False}
    # The assignment knows each station as one thing that never runs out.
    assert {c.object for c in planned.motions.task_plan.choices} == set(COPIES)


def test_both_robots_pick_from_the_station_between_them(planned: PlanResult) -> None:
    picks = [t for t in planned.tpg.tasks if t.kind == "pick"]
    order = "near.1 far.1 between.1 between.2 near.2 between.3"
    assert [t.object for t in picks] == order.split()
    between = [t for t in picks if (t.object or "").startswith("between")]
    assert len({t.robot for t in between}) == 2
    # Whoever picks waits for the pick before.
    pairs = {tuple(p) for p in planned.motions.motion_plan.dependencies.tolist()}
    for first, second in zip(between, between[1:], strict=False):
        if first.robot != second.robot:
            assert (first.index, second.index) in pairs


def test_the_next_brick_comes_up_at_the_end_of_a_pick(planned: PlanResult) -> None:
    tpg = planned.tpg
    for task in tpg.tasks:
        if task.kind != "pick":
            assert all(
                h.holder or task.kind.startswith("place") for h in task.handlings
            )
            continue
        taken, comes = task.handlings
        station, _, number = taken.object.rpartition(".")
        assert comes.object == f"{station}.{int(number) + 1}"
        assert (comes.holder, comes.waypoint) == (None, len(task.path))
        place = tpg.cell.object(f"{station}.1").start
        np.testing.assert_array_equal(comes.pose, place)
        np.testing.assert_array_equal(tpg.cell.object(comes.object).start, place)


def test_a_brick_always_stands_at_a_station(planned: PlanResult) -> None:
    """The rests at its place follow each other without a gap, from the start to the end."""
    tpg = planned.tpg
    history = DerivedTpg(tpg).history
    for station, count in COPIES.items():
        place = tpg.cell.object(f"{station}.1").start
        rests = [
            rest
            for k in range(1, count + 1)
            for rest in history.rests
            if rest.object == f"{station}.{k}" and np.array_equal(rest.pose, place)
        ]
        assert [r.object for r in rests] == [f"{station}.{k + 1}" for k in range(count)]
        assert rests[0].after is None
        assert rests[-1].before is None
        for one, following in zip(rests, rests[1:], strict=False):
            assert one.before == following.after is not None
        # The pick's node holds the brick it takes from its first moment on, and the next
        # one at its end.
        for rest in rests[1:]:
            assert rest.after is not None
            robot, node = rest.after
            spans = [s for s in history.spans if s.robot == robot]
            before = [s for s in spans if s.start == (node, 0) and not s.carried]
            assert np.array_equal(before[0].pose, place)
            assert any(s.object == rest.object and s.start[0] == node for s in spans)


def test_the_plan_is_safe_whatever_is_delayed(planned: PlanResult) -> None:
    report = verify_plan(planned.tpg)
    assert report.problems == ()
    standing = audit_standing_states(planned.tpg)
    assert standing.states > 0
    assert standing.violations == ()


def test_picks_of_one_station_out_of_order_are_found(planned: PlanResult) -> None:
    """Without the dependencies, the second proof misses an order that handling needs."""
    tpg = planned.tpg
    cut = replace(tpg, edges=tpg.edges[:0], cause=tpg.cause[:0])
    _, problems = check_structure(cut)
    handling = [p.message for p in problems if p.kind == "handling"]
    assert any("'between." in message for message in handling)


def test_the_run_is_clean_and_writes_when_bricks_come_up(
    planned: PlanResult, trial: RunResult
) -> None:
    rows = pq.read_table(trial.files / "objects.parquet").to_pylist()
    for station, count in COPIES.items():
        place = planned.motions.cell.object(f"{station}.1").start
        taken_until = 0.0
        for k in range(1, count + 1):
            first, *more = [r for r in rows if r["object"] == f"{station}.{k}"]
            assert first["parent"] == "world"
            np.testing.assert_allclose(first["xyz"], place[:3, 3])
            assert first["t_s"] >= taken_until
            assert (first["t_s"] == 0.0) == (k == 1)
            assert bool(more) == (k < count)
            if more:
                assert more[0]["parent"].endswith("/flange")
                taken_until = more[0]["t_s"]
    text = (trial.files / "events.jsonl").read_text()
    assert text.count("comes up at its station") == 6
    assert broken_chains(trial.files / "run.rrd") == []


def test_stalls_change_nothing_about_that(
    planned: PlanResult, scenario: Scenario, tmp_path: Path
) -> None:
    stalled = apply_variation(scenario, {"stalls.count_per_robot": 4})
    trial = executed(stalled, planned.tpg, tmp_path)
    assert max(trial.summary["stall_s"].values()) > 0.0


def test_plan_files_keep_what_comes_later(
    planned: PlanResult, trial: RunResult, tmp_path: Path
) -> None:
    save_plan(planned.tpg, tmp_path)
    loaded = load_plan(tmp_path)
    names = [(o.name, o.later) for o in planned.tpg.cell.objects]
    assert [(o.name, o.later) for o in loaded.cell.objects] == names
    ours, theirs = (
        [(h.object, h.node, h.holder) for h in tpg.handlings]
        for tpg in (planned.tpg, loaded)
    )
    assert ours == theirs
    assert audit_run(trial.files).violations == ()


def test_a_brick_that_comes_up_elsewhere_is_a_violation(
    planned: PlanResult, trial: RunResult
) -> None:
    """The audit holds the recording against the place that the plan gives."""
    recording = read_recording(trial.files, planned.tpg.cell)
    rows = tuple(
        replace(row, pose=translation(0.0, 0.0, 0.2) @ row.pose)
        if row.object == "far.2"
        else row
        for row in recording.objects
    )
    with Auditor(planned.tpg) as auditor:
        report = auditor.audit(replace(recording, objects=rows))
    jumps = [v for v in report.violations if v.second == "jump"]
    assert [v.first for v in jumps] == ["far.2"]
    assert jumps[0].depth_m == pytest.approx(0.2)


def test_the_task_graph_shows_where_bricks_come_from(planned: PlanResult) -> None:
    graph = task_graph(planned.tpg)
    picks = {t.object: f"task {t.index}" for t in planned.tpg.tasks if t.kind == "pick"}
    assert graph.edges[picks["near.1"], "near.2 0"]["kind"] == "detached"
    assert graph.edges["near.2 0", picks["near.2"]]["kind"] == "attached"


def test_nothing_is_picked_before_it_is_there(planned: PlanResult) -> None:
    plan = planned.motions.motion_plan
    tasks = tuple(
        replace(t, handlings=t.handlings[:1]) if t.object == "near.1" else t
        for t in plan.tasks
    )
    with pytest.raises(PlanInvariantError, match=r"'near\.2', which is not there yet"):
        build_tpg(replace(plan, tasks=tasks))


def test_a_run_that_stops_early_never_sees_the_later_bricks(
    planned: PlanResult, trial: RunResult
) -> None:
    record = trial.record
    assert record is not None
    first = min(p.t_ns for p in object_placements(planned.tpg, record) if p.t_ns)
    early = replace(record, makespan_ns=first - 1)
    names = {p.object for p in object_placements(planned.tpg, early)}
    assert names == {"near.1", "far.1", "between.1", "spare"}
