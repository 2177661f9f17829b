"""The state of a followed run, and what is flagged."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from tests.twin.drawn_runs import ANYTHING, TPGS, VARIED
from tests.twin.driven_toys import BENT_TPGS, DRIVEN_TPGS
from tests.twin.simulated import watched
from tests.twin.twin_toys import random_tpg, two_robot_tpg
from twin.engine.execution_model import Messages
from twin.engine.passage import drive_times
from twin.follow.state import FollowedRun
from twin.runs.events import Event, EventLogError, event_line
from twin.runs.execution_record import Policy
from twin.uncertainty.disturbances import (
    Breakdowns,
    Disturbances,
    EmergencyStop,
    FixedFactor,
    Speed,
    UniformFactor,
)


def texts(run: FollowedRun) -> list[str]:
    return [violation.text for violation in run.violations]


@settings(max_examples=40, deadline=None)
@given(
    TPGS,
    st.integers(0, 100),
    ANYTHING,
    st.sampled_from(["asynchronous", "sequential"]),
    st.sampled_from([0.0, 0.2]),
    st.integers(1, 3),
)
def test_the_state_equals_the_run_and_nothing_is_flagged(
    tpg: TemporalPlanGraph,
    seed: int,
    disturbances: Disturbances,
    policy: str,
    latency: float,
    depth: int,
) -> None:
    run, events = watched(
        tpg,
        VARIED,
        seed=seed,
        policy=policy,
        messages=Messages.of_seconds(depth, latency, latency),
        disturbances=disturbances,
    )
    followed = FollowedRun(tpg)
    for event in events:
        followed.apply(Event.parse(event_line(event)))
    assert texts(followed) == []
    assert followed.outcome == run.outcome
    for k, robot in enumerate(followed.robots):
        assert np.array_equal(robot.start_ns, run.start_ns[k])
        assert np.array_equal(robot.end_ns, run.end_ns[k])
        assert robot.failed == (run.failed_nodes[k] >= 0)
        if not any(run.stops_ns):
            done = run.end_ns[k] >= 0
            retried = {e.node for e in run.standstills[k] if e.cause == "retry"}
            for node in np.flatnonzero(done).tolist():
                if node not in retried:
                    assert robot.stood_ns[node] == run.stood_ns[k][node]


CLOCK = st.builds(
    Disturbances,
    emergency_stops=st.lists(
        st.builds(
            EmergencyStop,
            robot=st.sampled_from([None, "robot_0"]),
            at_s=st.floats(0.0, 12.0),
            duration_s=st.floats(0.001, 3.0),
        ),
        min_size=1,
        max_size=6,
    ).map(tuple),
    breakdowns=st.sampled_from([None, Breakdowns(mtbf_s=2.0, mttr_s=0.5, clock="run")]),
    speed=st.sampled_from(
        [
            Speed(),
            Speed(factor=FixedFactor(kind="fixed", value=0.3)),
            Speed(robots={"robot_0": UniformFactor(kind="uniform", low=0.2, high=1.0)}),
        ]
    ),
)
"""Stops by the clock, of robots at full speed and of slower ones."""


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    st.one_of(DRIVEN_TPGS, BENT_TPGS, TPGS),
    CLOCK,
    st.sampled_from(["asynchronous", "sequential"]),
    st.sampled_from([0.0, 0.2]),
    st.sampled_from([None, 1]),
    st.integers(0, 99),
)
def test_robots_that_brake_for_a_stop_by_the_clock_are_not_flagged(
    tpg: TemporalPlanGraph,
    disturbances: Disturbances,
    policy: Policy,
    latency: float,
    depth: int | None,
    seed: int,
) -> None:
    messages = Messages.of_seconds(depth, latency, latency)
    options = {"policy": policy, "seed": seed, "messages": messages}
    _, events = watched(tpg, VARIED, disturbances=disturbances, **options)
    followed = FollowedRun(tpg, policy, speed=disturbances.speed)
    for event in events:
        followed.apply(event)
    assert texts(followed) == []


@settings(max_examples=30, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    st.one_of(DRIVEN_TPGS, BENT_TPGS, TPGS),
    st.floats(0.05, 0.95),
    st.sampled_from([1.0, 0.4]),
    st.integers(0, 99),
)
def test_robots_that_heed_no_stop_are_flagged(
    tpg: TemporalPlanGraph, share: float, factor: float, seed: int
) -> None:
    """A stop is put into the log of a run that knows nothing of it."""
    speed = Speed(factor=FixedFactor(kind="fixed", value=factor))
    slow = Disturbances(speed=speed)
    run, events = watched(tpg, VARIED, seed=seed, disturbances=slow)
    since = round(share * run.makespan_ns)
    followed = FollowedRun(tpg, speed=speed)
    before = [e for e in events if e.t_ns < since]
    after = [e for e in events if e.t_ns >= since]
    stops = [Event(since, chain.robot, "stopped") for chain in tpg.chains]
    for event in [*before, *stops, *after]:
        followed.apply(event)
    flagged = {(v.robot, v.node) for v in followed.violations}
    for k, chain in enumerate(tpg.chains):
        drive = drive_times(chain, run.duration_ns[k], factor)
        opens = np.append(True, drive.last[1:] != drive.last[:-1])
        opens |= drive.length <= 0.0
        start, brakes = run.start_ns[k], drive.lag + drive.ramp
        told = {(c, n) for c, n in flagged if c == chain.robot}
        forbidden = (start >= since) & (opens | (start > since + brakes + 1))
        assert told >= {(chain.robot, n) for n in np.flatnonzero(forbidden).tolist()}
        allowed = (start < since + drive.lag) & ~opens
        assert not told & {(chain.robot, n) for n in np.flatnonzero(allowed).tolist()}
        # From rest, nothing begins that was not commanded before.
        rested = np.append(False, start[1:] > run.end_ns[k][:-1])
        late = rested & (start >= since + drive.lag)
        assert told >= {(chain.robot, n) for n in np.flatnonzero(late).tolist()}


def test_an_event_that_the_graph_forbids_is_named_with_its_edge() -> None:
    tpg = two_robot_tpg([(0, 1, 1, 0), (0, 2, 1, 2)])
    followed = FollowedRun(tpg)
    assert not followed.apply(Event(0, "robot_0", "started", 0, 0))
    (found,) = followed.apply(Event(5, "robot_1", "started", 1, 0))
    assert (found.robot, found.node, found.task) == ("robot_1", 0, 1)
    assert found.edges == (("robot_0", 1),)
    assert found.text == (
        "0.000 s: robot_1 started node 0 (transit 1), but the plan lets it wait for"
        " node 1 of robot_0 (transit 0; motion conflict)"
    )
    # The state goes on being that of the run.
    assert not followed.apply(Event(9, "robot_1", "completed", 1, 0))
    assert followed.robots[1].completed == 1
    assert followed.nodes_done == 1
    (late,) = followed.apply(Event(10, "robot_0", "completed", 0, 2))
    assert "node 2 (transit 0), but node 2 has not started" in late.text
    assert followed.robots[0].completed == 3
    assert not followed.apply(Event(11, "robot_1", "started", 1, 1))


def test_every_forbidden_swap_of_a_start_is_flagged() -> None:
    """Move each first start that waited for another robot to time 0: the graph says no."""
    tpg = random_tpg(16, dofs=(1, 2, 3), tasks=12, edges=25)
    events = watched(tpg, VARIED)[1]
    waited = [e for e in events if e.kind == "waiting"]
    assert len(waited) >= 3
    for event in waited:
        followed = FollowedRun(tpg)
        for other in events:
            followed.apply(other)
            if other is event:
                break
        found = followed.apply(replace(event, kind="started"))
        assert len(found) == 1
        assert found[0].edges
        for robot, node in found[0].edges:
            assert f"robot_{robot[-1]} to complete node {node} " in event.detail


@pytest.mark.parametrize(
    ("events", "text"),
    [
        ([Event(0, "robot_7", "started", 0, 0)], "no robot of the plan"),
        ([Event(0, "robot_0", "started", 0, 99)], "it has nodes 0 to 2"),
        ([Event(0, "robot_0", "started", 1, 0)], "node 0 is of task 0"),
        ([Event(0, "robot_0", "started", 0, 1)], "node 0 comes next"),
        ([Event(0, "robot_0", "started", -1, -1)], "it names no node"),
        ([Event(0, "robot_0", "started", 0, 0)] * 2, "node 0 has started before"),
        (
            [
                Event(0, "robot_0", "started", 0, 0),
                Event(1, "robot_0", "completed", 0, 0),
                Event(1, "robot_0", "completed", 0, 0),
            ],
            "node 0 is complete already",
        ),
        (
            [Event(0, "robot_0", "stopped"), Event(1, "robot_0", "started", 0, 0)],
            "the robot is stopped",
        ),
        (
            [Event(9, "robot_0", "started", 0, 0), Event(8, "robot_1", "stopped")],
            "comes after an event of 0.000 s",
        ),
        (
            [
                Event(0, "robot_0", "started", 0, 0),
                Event(1, "robot_0", "attached", 0, 0, "brick_0"),
            ],
            "the plan does not handle 'brick_0' in node 0",
        ),
    ],
)
def test_what_cannot_be_is_flagged(events: list[Event], text: str) -> None:
    followed = FollowedRun(two_robot_tpg([]))
    for event in events:
        followed.apply(event)
    assert len(followed.violations) == 1
    assert text in texts(followed)[0]


def test_an_open_loop_run_breaks_the_graph() -> None:
    tpg = two_robot_tpg([(0, 1, 1, 0)])
    slow = Speed(robots={"robot_0": FixedFactor(kind="fixed", value=0.5)})
    disturbed = Disturbances(speed=slow)
    _, events = watched(tpg, policy="open-loop", disturbances=disturbed)
    followed = FollowedRun(tpg)
    for event in events:
        followed.apply(event)
    assert [v.edges for v in followed.violations] == [(("robot_0", 1),)]


@pytest.mark.parametrize(
    ("line", "text"),
    [
        ("{", "not JSON"),
        ("[]", "not an object"),
        ('{"t_s": 1.0, "kind": "started"}', "no 'robot'"),
        ('{"t_s": 1.0, "robot": "a", "kind": "exploded"}', "unknown kind 'exploded'"),
        ('{"t_s": "x", "robot": "a", "kind": "started"}', "t_s is no number"),
        ('{"t_s": -1, "robot": "a", "kind": "started"}', "must be 0 to"),
        ('{"t_s": 1e999999, "robot": "a", "kind": "started"}', "must be 0 to"),
        ('{"t_s": 1e9999999999999999999}', "an exponent that no number has"),
        ('{"t_s": 9300000000, "robot": "a", "kind": "started"}', "must be 0 to"),
        ('{"t_s": 1, "robot": "a", "kind": ["started"]}', "unknown kind"),
        ('{"t_s": 1, "robot": "a", "kind": "started", "node": true}', "whole numbers"),
        (f'{{"t_s": {"9" * 5000}, "robot": "a", "kind": "started"}}', "not JSON"),
        ("[" * 100_000, "not JSON"),
        ('{"t_s": 1, "robot": "a", "kind": "started", "node": "3"}', "whole numbers"),
    ],
)
def test_lines_that_are_no_events_say_why(line: str, text: str) -> None:
    with pytest.raises(EventLogError, match=text):
        Event.parse(line)


def test_times_are_read_exactly() -> None:
    event = Event(12_345_678_901_234_567, "left", "started", 3, 4, "b", 'a "b"\n')
    assert Event.parse(event_line(event)) == event
