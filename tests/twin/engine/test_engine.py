import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import Result

from planning.cell.workcell import Workcell
from planning.errors import TwinError
from planning.motion.motion_plan import MotionPlan, TaskMotion
from planning.tasks.task import Task, TaskKind
from scheduling.build_tpg import build_tpg
from scheduling.graph.plan_files import save_plan
from scheduling.graph.rollout import earliest_times
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from tests.twin.drawn_runs import TPGS, VARIED, sample, sample_node_times
from tests.twin.program import invoke
from tests.twin.recorded_events import InterruptsAt, story
from tests.twin.simulated import NOMINAL, simulate, watched
from tests.twin.turning_arms import SCENARIO, straight
from tests.twin.twin_toys import random_tpg, two_robot_tpg
from twin.engine.engine import Simulator
from twin.engine.execution_model import ExecutionModel, Messages
from twin.planning.build_workcell import build_workcell
from twin.reading.scenario_file import load_scenario
from twin.recorders.observers import MemoryRecorder
from twin.runs.events import Event
from twin.runs.execution_record import DeadlockError, ExecutionRecord
from twin.uncertainty.contraction import contract
from twin.uncertainty.disturbances import Disturbances, Stalls

AnyArray = npt.NDArray[Any]


def same_times(
    run: ExecutionRecord, start: Sequence[AnyArray], end: Sequence[AnyArray]
) -> bool:
    return all(map(np.array_equal, run.start_ns, start)) and all(
        map(np.array_equal, run.end_ns, end)
    )


# What happens, word for word


def test_a_robot_waits_for_the_edge_and_goes_on() -> None:
    """robot_1 may start only when node 1 of robot_0 is complete."""
    _, events = watched(two_robot_tpg([(0, 1, 1, 0)]))
    assert story(events) == [
        (0.0, "robot_0", "released", 0),
        (0.0, "robot_0", "started", 0),
        (0.0, "robot_1", "waiting", 0),
        (1.0, "robot_0", "completed", 0),
        (1.0, "robot_0", "released", 1),
        (1.0, "robot_0", "started", 1),
        (2.0, "robot_0", "completed", 1),
        (2.0, "robot_0", "released", 2),
        (2.0, "robot_1", "released", 0),
        (2.0, "robot_0", "started", 2),
        (2.0, "robot_1", "started", 0),
        (3.0, "robot_0", "completed", 2),
        (3.0, "robot_0", "finished", -1),
        (3.0, "robot_1", "completed", 0),
        (3.0, "robot_1", "released", 1),
        (3.0, "robot_1", "started", 1),
        (4.0, "robot_1", "completed", 1),
        (4.0, "robot_1", "released", 2),
        (4.0, "robot_1", "started", 2),
        (5.0, "robot_1", "completed", 2),
        (5.0, "robot_1", "finished", -1),
        (5.0, "", "finished", -1),
    ]
    waiting = next(e for e in events if e.kind == "waiting")
    assert waiting.detail == "waits for robot_0 to complete node 1 (transit 0)"


@pytest.mark.parametrize(
    ("depth", "report_s", "release_s", "starts"),
    [
        # Released at 0, received at 0.1, complete at 1.1, known and released again at 1.2.
        (1, 0.1, 0.1, [0.1, 1.3, 2.5]),
        (1, 0.3, 0.1, [0.1, 1.5, 2.9]),
        (1, 0.0, 0.2, [0.2, 1.4, 2.6]),
        # A deeper queue hides latency.
        (2, 0.1, 0.1, [0.1, 1.1, 2.1]),
    ],
)
def test_messages_take_their_time(
    depth: int, report_s: float, release_s: float, starts: list[float]
) -> None:
    late = Messages.of_seconds(depth, report_s, release_s)
    run = simulate(two_robot_tpg([]), messages=late)
    for own in run.start_ns:
        assert (own / 1e9).tolist() == pytest.approx(starts)
    assert run.makespan_s == pytest.approx(starts[-1] + 1.0)


def test_a_deeper_queue_never_runs_ahead_of_another_robot() -> None:
    late = Messages.of_seconds(3, 0.1, 0.1)
    run = simulate(two_robot_tpg([(0, 1, 1, 1)]), messages=late)
    assert run.start_ns[1][1] == run.end_ns[0][1] + 2 * 10**8


def test_a_stall_delays_the_robot_and_those_that_wait_for_it() -> None:
    stalls = Disturbances(stalls=Stalls(count_per_robot=3, duration_s=(2.0, 2.0)))
    run, events = watched(two_robot_tpg([(0, 0, 1, 0)]), disturbances=stalls)
    assert (run.start_ns[0] / 1e9).tolist() == [0.0, 3.0, 6.0]
    assert (run.start_ns[1] / 1e9).tolist() == [3.0, 6.0, 9.0]
    assert run.wait_ns(0) == 0
    assert run.wait_ns(1) == 3 * 10**9
    assert run.standing_ns(0) == 6 * 10**9
    kinds = [e.kind for e in events if e.robot == "robot_0" and e.node == 0]
    assert kinds == ["released", "started", "stalled", "resumed", "completed"]


def test_objects_change_hands_at_their_waypoints() -> None:
    tpg = random_tpg(4, tasks=6, edges=0)
    run, events = watched(tpg, VARIED)
    changes = [e for e in events if e.kind in ("attached", "detached")]
    first, second = tpg.handlings
    expected = {
        ("attached", "brick_0", first.node),
        ("detached", "brick_0", second.node),
    }
    assert {(e.kind, e.object, e.node) for e in changes} == expected
    attached = next(e for e in changes if e.kind == "attached")
    chain = tpg.chains[first.robot]
    share = chain.fraction[chain.first[first.node]]
    start = run.start_ns[first.robot][first.node]
    duration = run.duration_ns[first.robot][first.node]
    assert attached.t_ns == start + round(share * duration)


# Against the longest paths of the rollout


@settings(max_examples=60, deadline=None)
@given(TPGS, st.integers(0, 100), st.sampled_from([1, 2, 7]))
def test_times_are_the_earliest_possible(
    tpg: TemporalPlanGraph, seed: int, depth: int
) -> None:
    earliest = earliest_times(tpg, sample(VARIED, tpg, seed=seed))
    deep = Messages(depth)
    contracted = simulate(tpg, VARIED, seed=seed, messages=deep)
    node_by_node, _ = watched(tpg, VARIED, seed=seed, messages=deep)
    for run in (contracted, node_by_node):
        assert same_times(run, earliest.start, earliest.end)
        assert run.makespan_ns == earliest.makespan
        assert [run.wait_ns(k) for k in range(len(tpg.chains))] == [
            end[-1] - busy.sum()
            for end, busy in zip(earliest.end, earliest.duration, strict=True)
        ]


@settings(max_examples=30, deadline=None)
@given(TPGS, st.integers(0, 100))
def test_stalls_lengthen_nodes_and_nothing_else(
    tpg: TemporalPlanGraph, seed: int
) -> None:
    stalls = Disturbances(stalls=Stalls(count_per_robot=2, duration_s=(0.5, 3.0)))
    times = sample_node_times(tpg, VARIED, stalls, seed=seed)
    busy = [d + s for d, s in zip(times.motion, times.stood, strict=True)]
    earliest = earliest_times(tpg, busy)
    for execute in (simulate, lambda *args, **how: watched(*args, **how)[0]):
        run = execute(tpg, VARIED, seed=seed, disturbances=stalls)
        assert same_times(run, earliest.start, earliest.end)


@settings(max_examples=30, deadline=None)
@given(TPGS, st.integers(0, 100))
def test_sequential_runs_take_the_sum_of_all_durations(
    tpg: TemporalPlanGraph, seed: int
) -> None:
    seen, events = watched(tpg, VARIED, seed=seed, policy="sequential")
    run = simulate(tpg, VARIED, seed=seed, policy="sequential")
    assert same_times(run, seen.start_ns, seen.end_ns)
    assert run.makespan_ns == sum(int(d.sum()) for d in run.duration_ns)
    assert run.makespan_ns >= simulate(tpg, VARIED, seed=seed).makespan_ns
    tasks = [e.task for e in events if e.kind == "started"]
    assert tasks == sorted(tasks)


@settings(max_examples=40, deadline=None)
@given(
    TPGS,
    st.integers(0, 100),
    st.floats(0.001, 2.0),
    st.integers(1, 4),
    st.sampled_from(["asynchronous", "sequential"]),
)
def test_no_node_starts_before_what_it_waits_for(
    tpg: TemporalPlanGraph, seed: int, latency: float, depth: int, policy: str
) -> None:
    run = simulate(
        tpg,
        VARIED,
        seed=seed,
        messages=Messages.of_seconds(depth, latency, latency),
        policy=policy,
        disturbances=Disturbances(
            stalls=Stalls(count_per_robot=1, duration_s=(0.5, 3.0))
        ),
    )
    assert run.outcome == "completed"
    message = round(latency * 1e9)
    for a, m, b, n in tpg.edges.tolist():
        assert run.start_ns[b][n] >= run.end_ns[a][m] + 2 * message
    for k in range(len(tpg.chains)):
        busy = run.duration_ns[k] + run.stood_ns[k]
        assert np.array_equal(run.end_ns[k] - run.start_ns[k], busy)
        assert np.all(run.start_ns[k][1:] >= run.end_ns[k][:-1])
        assert run.start_ns[k][0] >= message


@settings(max_examples=40, deadline=None)
@given(TPGS)
def test_contraction_joins_only_what_no_other_robot_knows(
    tpg: TemporalPlanGraph,
) -> None:
    contraction = contract(tpg)
    for k, chain in enumerate(tpg.chains):
        first = set(contraction.first[k].tolist())
        assert {0, len(chain)} <= first
        for a, m, b, n in tpg.edges.tolist():
            assert b != k or n in first
            assert a != k or m + 1 in first


# Failures


def test_a_deadlock_names_who_waits_for_whom_and_keeps_the_log() -> None:
    recorder = MemoryRecorder()
    stuck = two_robot_tpg([(0, 1, 1, 1), (1, 2, 0, 1)])
    with pytest.raises(DeadlockError, match="robot_0"):
        simulate(stuck)
    with pytest.raises(DeadlockError) as caught:
        simulate(stuck, recorders=[recorder])
    assert "robot_0 at node 1 waits for robot_1 to complete node 2" in str(caught.value)
    assert "robot_1 at node 1 waits for robot_0 to complete node 1" in str(caught.value)
    assert caught.value.run.outcome == "failed"
    assert caught.value.run.end_ns[0].tolist() == [10**9, -1, -1]
    assert [e.kind for e in recorder.events[-2:]] == ["failed", "finished"]


@pytest.mark.parametrize("count", [1, 4, 9, 20])
def test_an_interrupt_leaves_what_happened(count: int) -> None:
    memory, interrupts = MemoryRecorder(), InterruptsAt(count)
    run = simulate(two_robot_tpg([(0, 1, 1, 0)]), recorders=[memory, interrupts])
    assert run.outcome == "aborted"
    assert interrupts.closed
    assert [e.kind for e in memory.events[-2:]] == ["stopped", "finished"]
    # SimPy lets what is due at that time happen before it passes the interrupt on.
    assert len(memory.events) >= count + 2
    assert memory.events[count - 1].t_ns == memory.events[-1].t_ns
    assert run.makespan_ns == memory.events[-1].t_ns
    assert max(end.max() for end in run.end_ns) <= run.makespan_ns


class Fails:
    def __init__(self, at_close: bool = False) -> None:
        self.at_close = at_close
        self.told = 0

    def record(self, event: Event) -> None:
        self.told += 1
        if self.told == 3 and not self.at_close:
            raise OSError("disk full")

    def close(self) -> None:
        if self.at_close:
            raise OSError("disk full")


@pytest.mark.parametrize("at_close", [False, True])
def test_a_recorder_that_fails_is_dropped(
    at_close: bool, caplog: pytest.LogCaptureFixture
) -> None:
    memory, fails = MemoryRecorder(), Fails(at_close)
    run = simulate(two_robot_tpg([]), recorders=[fails, memory])
    assert run.outcome == "completed"
    assert memory.events[-1].kind == "finished"
    assert "disk full" in caplog.text
    assert at_close or fails.told == 3


@pytest.mark.parametrize(
    "make",
    [
        lambda: Simulator(two_robot_tpg([]), ExecutionModel(NOMINAL, "parallel")),
        lambda: Messages.of_seconds(queue_depth=0),
        lambda: Messages.of_seconds(report_s=-1.0),
    ],
)
def test_arguments_out_of_range_are_refused(make: Callable[[], object]) -> None:
    with pytest.raises(TwinError):
        make()


def test_a_tpg_without_work_ends_at_once() -> None:
    empty = replace(two_robot_tpg([]), chains=())
    run, _ = watched(empty)
    assert (run.outcome, run.makespan_ns) == ("completed", 0)
    assert simulate(empty).makespan_ns == 0


LATE = """\
  speed: {robots: {left: {kind: fixed, value: 0.25}}}
"""
REACH = np.array([0.0, 0.8, 1.0, 0.0, 0.6, 0.0])
"""From HOME forward, to where the other arm reaches too."""


def reaching_plan(cell: Workcell) -> MotionPlan:
    """Each arm reaches forward and comes back, one after the other."""
    tasks: list[Task] = []
    motions: list[TaskMotion] = []
    clock = 0.0
    for robot in cell.robots:
        for k, (a, b) in enumerate(((0.0, 1.0), (1.0, 0.0))):
            path = straight(robot.home + a * REACH, robot.home + b * REACH, 25)
            time = clock + np.linspace(0.0, 1.2, len(path))
            label = f"{'back' if k else 'there'} of {robot.name}"
            tasks.append(
                Task(len(tasks), robot.name, TaskKind.TRANSIT, 1, label, path[-1:])
            )
            motions.append(TaskMotion(path, time))
            clock = float(time[-1])
    nothing = np.empty((0, 2), dtype=np.int64)
    return MotionPlan(cell, tuple(tasks), tuple(motions), nothing, ())


@pytest.fixture(scope="module")
def plan(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("plan")
    (folder / "two.yaml").write_text(SCENARIO + LATE)
    cell = build_workcell(load_scenario(folder / "two.yaml"), folder)
    tpg = build_tpg(reaching_plan(cell))
    assert len(tpg.edges) > 3
    save_plan(tpg, folder)
    return folder


def run(plan: Path, out: Path, policy: str) -> tuple[Result, dict[str, Any]]:
    where = ("run", plan / "two.yaml", "--plan", plan, "--out", out)
    result = invoke(*where, "--policy", policy, "--no-recording", "--json")
    return result, json.loads((out / "summary.json").read_text())


def test_a_late_robot_is_waited_for(plan: Path, tmp_path: Path) -> None:
    result, summary = run(plan, tmp_path / "run", "asynchronous")
    assert result.exit_code == 0, result.output
    assert summary["audit"]["violations"] == []
    assert summary["wait_s"]["right"] > 3.0


def test_in_open_loop_a_late_robot_is_run_into(plan: Path, tmp_path: Path) -> None:
    """What the audit finds are violations, and the run does not pass."""
    result, summary = run(plan, tmp_path / "run", "open-loop")
    assert result.exit_code == 1
    assert summary["outcome"] == "completed"
    found = summary["audit"]["violations"]
    assert found
    assert all(
        {entry["first"].split("/")[0], entry["second"].split("/")[0]}
        == {"left", "right"}
        for entry in found
    )
    assert summary["audit"]["min_distance_m"] < -0.01
