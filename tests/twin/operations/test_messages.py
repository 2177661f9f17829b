"""Messages that are on their way when it is planned anew, what robots are released ahead, and what passes borders at speed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from tests.twin.operations.operated import lost, operated, require_kept
from twin.durations.nanoseconds import NANOSECONDS
from twin.operations.operation import operate
from twin.runs.events import Event
from twin.trial.loaded_scenario import load
from twin.trial.plan_result import PlanResult
from twin.trial.planning import plan_scenario
from twin.trial.simulation import scenario_execution


@settings(max_examples=3, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    report_s=st.sampled_from([0.0, 1.0, 10.0]),
    release_s=st.sampled_from([0.0, 1.0, 10.0]),
    depth=st.integers(1, 8),
    planning_s=st.sampled_from([0.0, 1.0]),
)
# A report of a node before the one that failed came after the swap.
@example(seed=9, report_s=10.0, release_s=10.0, depth=2, planning_s=0.1)
# A robot took what it had been released before for what it was released then.
@example(seed=20, report_s=4.0, release_s=10.0, depth=5, planning_s=1.0)
def test_nobody_begins_before_a_release_has_come_that_still_counts(
    plan: PlanResult,
    seed: int,
    report_s: float,
    release_s: float,
    depth: int,
    planning_s: float,
) -> None:
    done, events = operated(
        plan,
        seed,
        report_latency_s=report_s,
        release_latency_s=release_s,
        queue_depth=depth,
        **{"recovery.planning_s": planning_s},
        **lost(0.3),
    )
    released = dict[tuple[str, int], int]()
    for event in events:
        if event.kind == "released":
            released[event.robot, event.node] = event.t_ns
        elif event.kind == "started":
            came = released[event.robot, event.node] + release_s * NANOSECONDS
            assert event.t_ns >= came
    require_kept(done, round((report_s + release_s) * NANOSECONDS))


def test_a_failure_is_told_by_a_message_as_all_else(plan: PlanResult) -> None:
    at_once = {"recovery.planning_s": 0.0}
    _, events = operated(plan, 6, report_latency_s=7.0, **lost(0.3), **at_once)
    failed = next(event.t_ns for event in events if event.kind == "failed")
    planned_anew = next(event.t_ns for event in events if event.kind == "replanned")
    assert planned_anew == failed + 7 * NANOSECONDS


@pytest.mark.nightly
@settings(max_examples=3, deadline=None)
@given(seed=st.integers(0, 10_000), planning_s=st.sampled_from([0.0, 3.0]))
@example(seed=5473, planning_s=0.0)  # a failure was known before what came before it
def test_messages_of_three_robots_are_kept(seed: int, planning_s: float) -> None:
    plan = plan_scenario(load("taskboard"), keep=True)
    late: dict[str, Any] = {"report_latency_s": 10.0, "queue_depth": 7}
    done, _ = operated(
        plan, seed, **late, **lost(0.3), **{"recovery.planning_s": planning_s}
    )
    require_kept(done, 10 * NANOSECONDS)


def begun_between(events: list[Event], first: int, last: int) -> list[Event]:
    """Return what robots have begun from one time to another."""
    return [e for e in events if e.kind == "started" and first < e.t_ns < last]


def planned_anew(
    plan: PlanResult, *, halting: bool, **values: Any
) -> tuple[list[Event], int, int, set[int]]:
    """Operate until something fails; return events, when, when it is planned, and tasks at hand then."""
    done, events = operated(plan, 6, halting, **lost(0.3), **values)
    fails = next(e.t_ns for e in events if e.kind == "failed")
    swap = next(e.t_ns for e in events if e.kind == "replanned")
    at_hand = set()
    for k, chain in enumerate(done.tpg.chains):
        busy = np.flatnonzero(
            (done.record.start_ns[k] <= fails) & (done.record.end_ns[k] > fails)
        )
        at_hand |= set(chain.task[busy].tolist())
    return events, fails, swap, at_hand


def test_who_halts_ends_the_task_at_hand_and_no_more(plan: PlanResult) -> None:
    slow = {"recovery.planning_s": 20.0}
    events, fails, swap, at_hand = planned_anew(plan, halting=True, **slow)
    assert {e.task for e in begun_between(events, fails, swap)} <= at_hand
    events, fails, swap, at_hand = planned_anew(plan, halting=False, **slow)
    assert {e.task for e in begun_between(events, fails, swap)} - at_hand


def test_no_task_is_released_long_before_it_begins(plan: PlanResult) -> None:
    done, events = operated(plan, 1, **lost(1e-9))
    assert not done.versions
    first = dict[int, int]()
    for event in events:
        if event.kind == "released":
            first.setdefault(event.task, event.t_ns)
    _, freely = operated(plan, 1)
    begins = dict[int, int]()
    for event in freely:
        if event.kind == "started":
            begins.setdefault(event.task, event.t_ns)
    longest = max(float(chain.duration.max()) for chain in done.tpg.chains)
    # And nobody is slower for it.
    ends = [
        max(e.t_ns for e in own if e.kind == "completed") for own in (events, freely)
    ]
    assert ends[0] == ends[1]
    for task, at in first.items():
        assert begins[task] - at <= (0.5 + longest) * NANOSECONDS


@pytest.fixture(scope="module")
def within_limits() -> PlanResult:
    return plan_scenario(load("taskboard"), keep=True)


@pytest.mark.nightly
def test_what_follows_a_rest_begins_when_the_motion_before_has_ended(
    within_limits: PlanResult,
) -> None:
    """A robot waits in the middle of a way, and is given one there that has a corner at once."""
    plan = within_limits
    case = plan.scenario.varied({"outages": [{"robot": "back", "at_s": 1.416}]})
    model = scenario_execution(case.sections, case.folder)
    done = operate(case.sections, plan.motions, plan.tpg, model, seed=0)
    for chain, start, end in zip(
        done.tpg.chains, done.record.start_ns, done.record.end_ns, strict=True
    ):
        assert chain.drive is not None
        rests = chain.drive.rests[:-1]
        assert (start[1:][rests] >= end[:-1][rests]).all()
        assert (start >= 0).all()
