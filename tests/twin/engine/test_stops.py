"""Stops by the clock: emergency stops and breakdowns; and tasks that fail for good."""

from itertools import pairwise
from typing import Any

import networkx as nx
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from tests.twin.activities.lane_oracle import robot_lanes
from tests.twin.drawn_runs import ANYTHING, STOPS, TPGS, VARIED
from tests.twin.recorded_events import story
from tests.twin.simulated import simulate, stopped, watched
from tests.twin.twin_toys import random_tpg, two_robot_tpg
from twin.activities.activities import FAILED
from twin.activities.progress import STOPPED
from twin.durations.bounded import Fixed, Uniform
from twin.recorders.observers import MemoryRecorder
from twin.runs.execution_record import ExecutionRecord
from twin.runs.trajectory import object_placements, robot_trajectories
from twin.uncertainty.disturbances import (
    Breakdowns,
    Disturbances,
    EmergencyStop,
    FixedFactor,
    SkillFailure,
    Speed,
    Stalls,
)
from twin.uncertainty.repair_crew import CrewSource, RepairCrew
from twin.uncertainty.stop import Stop
from twin.uncertainty.stop_times import StoppedClock, Stops


def stops_at(*intervals: tuple[int, int]) -> Stops:
    return Stops([Stop(a, b, "emergency", "") for a, b in intervals])


# The calendar of one robot, against counting instant by instant


INTERVALS = st.lists(
    st.tuples(st.integers(0, 30), st.integers(0, 8)).map(lambda p: (p[0], sum(p))),
    max_size=5,
)


@given(INTERVALS, st.integers(0, 40), st.integers(0, 20))
def test_work_advances_only_while_not_stopped(
    intervals: list[tuple[int, int]], begin: int, busy: int
) -> None:
    stops = stops_at(*intervals)
    stopped = {t for a, b in intervals for t in range(a, b)}
    inside = stopped.intersection(range(begin, begin + busy))
    assert stops.stopped_between(begin, begin + busy) == len(inside)
    expected = begin
    while expected in stopped:
        expected += 1
    assert stops.after(begin) == expected
    start, left = expected, busy
    while left:
        left -= expected not in stopped
        expected += 1
    while expected in stopped:  # what would be done when a stop begins is done after it
        expected += 1
    assert stops.advance(start, busy) == expected
    assert stops.expand(np.array([start]), np.array([busy])).tolist() == [expected]


@given(INTERVALS, st.integers(0, 60))
def test_own_time_stands_while_stopped(
    intervals: list[tuple[int, int]], t: int
) -> None:
    stops = stops_at(*intervals)
    pace = StoppedClock(stops.intervals(10**6))
    stopped = {s for a, b in intervals for s in range(a, b)}
    own = int(pace.own(np.array([t]))[0])
    assert own == sum(s not in stopped for s in range(t))
    back = int(pace.real(np.array([own]))[0])
    assert back >= t
    assert back not in stopped
    assert all(s in stopped for s in range(t, back))


def test_breakdowns_by_the_clock_are_the_same_however_they_are_asked_for() -> None:
    def fresh() -> Stops:
        breaks = Breakdowns(mtbf_s=10.0, mttr_s=3.0, clock="run")
        return Stops([], [CrewSource(RepairCrew(1, {"left": breaks}, 4, 0), "left")])

    late = fresh()
    late.after(10**12)
    early = fresh()
    for t in range(0, 10**12, 10**10):
        early.after(t)
    assert early.intervals(10**12) == late.intervals(10**12)
    spans = late.intervals(10**12)
    assert len(spans) > 40
    up = np.diff([0, *(t for span in spans for t in span)])[::2] / 1e9
    assert np.mean(up) == pytest.approx(10.0, rel=0.4)


@given(INTERVALS, st.integers(0, 3), st.lists(st.integers(0, 20), max_size=12))
def test_stops_that_become_known_late_change_nothing(
    fixed: list[tuple[int, int]], seed: int, work: list[int]
) -> None:
    """Asked in small steps, with a crew that another robot asks too, against all stops known at once."""
    breaks = {
        name: Breakdowns(
            mtbf=Uniform(low_s=1e-9, high_s=9e-9),
            mttr=Uniform(low_s=1e-9, high_s=6e-9),
            clock="run",
        )
        for name in ("left", "right")
    }

    def stops_of_both() -> list[Stops]:
        crew = RepairCrew(2, breaks, seed, 0)
        stops = [Stop(a, b, "emergency", "") for a, b in fixed]
        return [Stops(list(stops), [CrewSource(crew, name)]) for name in breaks]

    for late, whole in zip(stops_of_both(), stops_of_both(), strict=True):
        known = Stops(whole.until(1000))
        now = 0
        for busy in work:
            now = late.after(now)
            assert now == known.after(now)
            then = late.advance(now, busy)
            assert then == known.advance(now, busy)
            now = then


# Runs


def failing_picks(
    probability: float, retries: int, retry: Fixed | None = None
) -> dict[str, SkillFailure]:
    own = SkillFailure(probability=probability, retries=retries, retry=retry)
    return {"pick": own}


def test_a_stop_freezes_a_node_and_the_others_wait_for_it() -> None:
    """robot_1 waits for node 1 of robot_0, which stops in the middle of it."""
    stop = stopped(1.5, 10.0, "robot_0")
    run, events = watched(two_robot_tpg([(0, 1, 1, 0)]), disturbances=stop)
    assert (run.end_ns[0] / 1e9).tolist() == [1.0, 12.0, 13.0]
    assert (run.start_ns[1] / 1e9).tolist() == [12.0, 13.0, 14.0]
    assert run.wait_ns(0) == 0
    rows = [row for row in story(events) if row[2] in ("stopped", "resumed")]
    assert rows == [(1.5, "robot_0", "stopped", 1), (11.5, "robot_0", "resumed", 1)]
    times = [event.t_ns for event in events]
    assert times == sorted(times)


def test_everyone_stops_also_who_waits() -> None:
    run = simulate(two_robot_tpg([(0, 0, 1, 0)]), disturbances=stopped(1.0, 5.0))
    # At the instant of the stop nothing is complete any more.
    assert (run.end_ns[0] / 1e9).tolist() == [6.0, 7.0, 8.0]
    assert (run.start_ns[1] / 1e9).tolist() == [6.0, 7.0, 8.0]
    assert run.stops_ns == (((10**9, 6 * 10**9),),) * 2


def test_a_stop_after_the_end_changes_nothing() -> None:
    run, events = watched(two_robot_tpg([]), disturbances=stopped(100.0, 5.0))
    assert run.makespan_s == 3.0
    assert run.stops_ns == ((), ())
    assert "stopped" not in {event.kind for event in events}


def dependent_nodes(
    tpg: TemporalPlanGraph, sources: list[tuple[int, int]]
) -> set[tuple[int, int]]:
    """Every node that can be reached from some, themselves included, by brute force."""
    graph: nx.DiGraph[tuple[int, int]] = nx.DiGraph()
    for k, chain in enumerate(tpg.chains):
        graph.add_nodes_from((k, n) for n in range(len(chain)))
        graph.add_edges_from(pairwise((k, n) for n in range(len(chain))))
    graph.add_edges_from(((a, m), (b, n)) for a, m, b, n in tpg.edges.tolist())
    reached = set(sources)
    for source in sources:
        reached |= nx.descendants(graph, source)
    return reached


@settings(max_examples=60, deadline=None)
@given(TPGS, st.integers(0, 100), st.floats(0.0, 30.0), st.booleans())
def test_when_one_robot_stops_the_others_go_on_as_far_as_the_graph_allows(
    tpg: TemporalPlanGraph, seed: int, at_s: float, told: bool
) -> None:
    """A stop of many days: whatever does not depend on the rest of its nodes happens at once."""
    stop = stopped(at_s, 1e6, "robot_0")
    recorders = [MemoryRecorder()] if told else []
    run = simulate(tpg, VARIED, seed=seed, disturbances=stop, recorders=recorders)
    free = simulate(tpg, VARIED, seed=seed)
    stop_ns = round(at_s * 1e9)
    left = [(0, n) for n in range(len(tpg.chains[0])) if run.end_ns[0][n] >= stop_ns]
    blocked = dependent_nodes(tpg, left)
    assert set(left) == {
        (0, n) for n in range(len(tpg.chains[0])) if free.end_ns[0][n] >= stop_ns
    }
    for k in range(1, len(tpg.chains)):
        for node in range(len(tpg.chains[k])):
            if (k, node) in blocked:
                assert run.start_ns[k][node] >= stop_ns + 10**15
            else:
                assert run.end_ns[k][node] == free.end_ns[k][node]
    assert run.outcome == "completed"


@settings(max_examples=60, deadline=None)
@given(
    TPGS,
    st.integers(0, 100),
    ANYTHING,
    st.sampled_from(["asynchronous", "sequential", "open-loop"]),
)
def test_watched_and_contracted_runs_are_the_same(
    tpg: TemporalPlanGraph, seed: int, disturbances: Disturbances, policy: str
) -> None:
    options: Any = {"seed": seed, "policy": policy, "disturbances": disturbances}
    quick = simulate(tpg, VARIED, **options)
    seen, events = watched(tpg, VARIED, **options)
    assert quick.outcome == seen.outcome
    assert quick.makespan_ns == seen.makespan_ns
    assert all(map(np.array_equal, quick.start_ns, seen.start_ns))
    assert all(map(np.array_equal, quick.end_ns, seen.end_ns))
    assert quick.failure == seen.failure
    assert quick.stops_ns == seen.stops_ns
    times = [event.t_ns for event in events]
    assert times == sorted(times)
    _check_trajectories(tpg, seen)


def _check_trajectories(tpg: TemporalPlanGraph, run: ExecutionRecord) -> None:
    """Robots stand while stopped, arrive when nodes end, and never jump."""
    for k, motion in enumerate(robot_trajectories(tpg, run)):
        assert (motion.t_ns[0], motion.t_ns[-1]) == (0, run.makespan_ns)
        assert np.all(np.diff(motion.t_ns) >= 0)
        still = np.diff(motion.t_ns) == 0
        moved = np.any(np.abs(np.diff(motion.q, axis=0)) > 1e-9, axis=1)
        durations = np.append(run.duration_ns[k], 1)
        assert not np.any(still & moved & (durations[motion.node[1:]] != 0))
        for low, high in run.stops_ns[k]:
            times = np.linspace(low, high, 5).astype(np.int64)[1:-1]
            if len(set(times.tolist())) == 3:
                q = motion.at(times)
                assert np.abs(q - q[0]).max() < 1e-9
        done = np.flatnonzero(run.end_ns[k] >= 0)
        for node in done.tolist():
            chain = tpg.chains[k]
            goal = chain.waypoints[chain.first[node + 1] - 1]
            rows = motion.t_ns == run.end_ns[k][node]
            assert np.abs(motion.q[rows] - goal).max(axis=1).min() < 1e-9
    for lane in robot_lanes(tpg, run):
        edges = [(span.start_ns, span.end_ns) for span in lane.spans]
        assert all(a[1] == b[0] for a, b in pairwise(edges))
        if edges:
            assert (edges[0][0], edges[-1][1]) == (0, run.makespan_ns)


@settings(max_examples=30, deadline=None)
@given(TPGS, st.integers(0, 100), STOPS)
def test_objects_change_hands_when_the_log_says_so(
    tpg: TemporalPlanGraph, seed: int, stops: list[EmergencyStop]
) -> None:
    disturbances = Disturbances(
        emergency_stops=tuple(stops), failures=failing_picks(0.5, 1)
    )
    run, events = watched(tpg, VARIED, seed=seed, disturbances=disturbances)
    told = [
        (event.t_ns, event.object)
        for event in events
        if event.kind in ("attached", "detached")
    ]
    placed = [(p.t_ns, p.object) for p in object_placements(tpg, run)]
    assert told == placed[len(tpg.cell.objects) :]


def test_lanes_show_stops_and_failures() -> None:
    tpg = random_tpg(16, tasks=20)
    stop = stopped(5.0, 3.0, failures=failing_picks(1.0, 1))
    run = simulate(tpg, VARIED, disturbances=stop)
    for lane in robot_lanes(tpg, run):
        spans = [s for s in lane.spans if s.state == STOPPED]
        assert [(s.start_ns, s.end_ns) for s in spans] == [(5 * 10**9, 8 * 10**9)]
    assert any(s.state == FAILED for lane in robot_lanes(tpg, run) for s in lane.spans)


# Tasks that fail


def test_a_task_that_fails_for_good_is_named() -> None:
    tpg = random_tpg(16, tasks=20)
    failing = Disturbances(failures=failing_picks(1.0, 1, Fixed(value_s=2.0)))
    run, events = watched(tpg, VARIED, disturbances=failing)
    assert run.outcome == "failed"
    failed = [event for event in events if event.kind == "failed"]
    assert len(failed) == sum(node >= 0 for node in run.failed_nodes) > 0
    for event in failed:
        assert tpg.tasks[event.task].kind == "pick"
        assert f"task {event.task} ({tpg.tasks[event.task].label})" in run.failure
        assert event.detail.endswith("attempt 2 of 2 failed")
        own = [
            (e.kind, e.detail)
            for e in events
            if (e.robot, e.node) == (event.robot, event.node) and e.kind != "waiting"
        ]
        assert own[:3] == [
            ("released", ""),
            ("started", ""),
            ("retried", "attempt 1 failed after 2.000 s"),
        ]
        start = next(
            e.t_ns
            for e in events
            if (e.robot, e.node, e.kind) == (event.robot, event.node, "started")
        )
        assert event.t_ns == start + 4 * 10**9
    assert events[-1].detail == "failed"


@settings(max_examples=40, deadline=None)
@given(TPGS, st.integers(0, 100))
def test_when_a_task_fails_the_others_go_on_as_far_as_the_graph_allows(
    tpg: TemporalPlanGraph, seed: int
) -> None:
    failing = Disturbances(failures=failing_picks(0.6, 0))
    run = simulate(tpg, VARIED, seed=seed, disturbances=failing)
    sources = [(k, node) for k, node in enumerate(run.failed_nodes) if node >= 0]
    blocked = dependent_nodes(tpg, sources)
    for k in range(len(tpg.chains)):
        for node in range(len(tpg.chains[k])):
            assert (run.end_ns[k][node] < 0) == ((k, node) in blocked)
    assert run.outcome == ("failed" if sources else "completed")


def test_two_policies_see_the_same_failures_and_durations() -> None:
    tpg = random_tpg(16, tasks=20)
    disturbances = Disturbances(
        jitter=Uniform(low_s=0.0, high_s=0.1),
        stalls=Stalls(rate_per_h=300.0, duration=Uniform(low_s=1.0, high_s=2.0)),
        breakdowns=Breakdowns(mtbf_s=30.0, mttr_s=5.0),
        failures=failing_picks(0.4, 5),
    )
    runs = [
        simulate(tpg, VARIED, seed=3, policy=policy, disturbances=disturbances)
        for policy in ("asynchronous", "sequential", "open-loop")
    ]
    for run in runs[1:]:
        assert run.standstills == runs[0].standstills
        assert all(map(np.array_equal, run.duration_ns, runs[0].duration_ns))
    assert len({run.makespan_ns for run in runs}) > 1


# Open loop


def test_in_open_loop_nobody_waits_for_anybody() -> None:
    """robot_0 is late; robot_1, which the graph lets wait for it, keeps to its clock."""
    slow = Speed(robots={"robot_0": FixedFactor(kind="fixed", value=0.5)})
    run, events = watched(
        two_robot_tpg([(0, 1, 1, 0)]),
        policy="open-loop",
        disturbances=Disturbances(speed=slow),
    )
    assert (run.start_ns[0] / 1e9).tolist() == [0.0, 2.0, 4.0]
    assert (run.start_ns[1] / 1e9).tolist() == [2.0, 3.0, 4.0]
    assert run.start_ns[1][0] < run.end_ns[0][1]  # what the graph forbids
    waiting = [event for event in events if event.kind == "waiting"]
    assert [e.detail for e in waiting] == ["waits for its planned start at 2.000 s"]
    assert "released" not in {event.kind for event in events}


@settings(max_examples=30, deadline=None)
@given(TPGS)
def test_in_open_loop_undisturbed_nodes_keep_the_planned_clock(
    tpg: TemporalPlanGraph,
) -> None:
    planned = simulate(tpg)
    run = simulate(tpg, policy="open-loop")
    assert all(map(np.array_equal, run.start_ns, planned.start_ns))
