"""What robots did, told from the event log, against what follows from the times of the run."""

from dataclasses import replace
from itertools import groupby, pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.tasks.task import TaskKind
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from tests.twin.activities.lane_oracle import Span, robot_lanes
from tests.twin.drawn_runs import ANYTHING, TPGS, VARIED
from tests.twin.simulated import watched
from tests.twin.twin_toys import toy_cell, two_robot_tpg
from twin.activities.activities import (
    HOLDING,
    IDLE,
    WAITING,
    Activity,
    part_names,
    robot_activities,
)
from twin.activities.progress import STOPPED
from twin.durations.nanoseconds import NANOSECONDS
from twin.runs.events import Event
from twin.uncertainty.disturbances import Disturbances

Stretch = tuple[str, int, int, int]


def _stretch(item: Activity | Span) -> Stretch:
    """Return a stretch; lanes do not say what a robot waits or stands for that never goes on."""
    standing = item.state in (WAITING, HOLDING, STOPPED)
    # Who holds something waits, for those who look at times alone.
    state = WAITING if item.state == HOLDING else item.state
    return state, item.start_ns, item.end_ns, -1 if standing else item.task


def merged(stretches: list[Stretch]) -> list[Stretch]:
    """Join neighbours of one state and task."""
    out = []
    for _, group in groupby(stretches, key=lambda s: (s[0], s[3])):
        items = list(group)
        out.append((items[0][0], items[0][1], items[-1][2], items[0][3]))
    return out


@settings(max_examples=80, deadline=None)
@given(
    TPGS,
    st.integers(0, 100),
    ANYTHING,
    st.sampled_from(["asynchronous", "sequential", "open-loop"]),
)
def test_the_log_tells_the_same_as_the_run(
    tpg: TemporalPlanGraph, seed: int, disturbances: Disturbances, policy: str
) -> None:
    options = {"seed": seed, "policy": policy, "disturbances": disturbances}
    run, events = watched(tpg, VARIED, **options)
    told = robot_activities(tpg, events)
    lanes = {lane.robot: lane for lane in robot_lanes(tpg, run)}
    for robot, activities in told.items():
        spans = [s for s in lanes[robot].spans if s.state != IDLE]
        expected = merged([_stretch(s) for s in spans])
        found = merged([_stretch(a) for a in activities])
        assert found == expected
        _check_nodes(tpg, robot, activities)
        single = robot_activities(tpg, events, nodes=True)[robot]
        assert sum(a.duration_ns for a in single) == sum(
            a.duration_ns for a in activities
        )
        assert all(a.first == a.last for a in single)


def _check_nodes(
    tpg: TemporalPlanGraph, robot: str, activities: tuple[Activity, ...]
) -> None:
    """Stretches touch each other, and their nodes belong to their tasks."""
    chain = next(c for c in tpg.chains if c.robot == robot)
    for before, after in pairwise(activities):
        assert before.end_ns == after.start_ns
    for item in activities:
        assert item.duration_ns > 0
        if item.task >= 0:
            assert set(chain.task[item.first : item.last + 1].tolist()) == {item.task}


def test_a_robot_that_has_done_nothing_yet_waits() -> None:
    tpg = two_robot_tpg([])
    events = [Event(0, "robot_0", "started", 0, 0), Event(5, "", "stopped")]
    told = robot_activities(tpg, events)
    assert told["robot_0"] == (Activity("transit", 0, 5, 0, 0, 0),)
    assert told["robot_1"] == (Activity(WAITING, 0, 5, 1, 0, 0),)


@pytest.mark.parametrize("kept", [False, True])
def test_who_holds_something_until_others_are_done_does_not_wait(kept: bool) -> None:
    """A support, and a robot that keeps hold of what it placed; one with no such task waits."""
    tpg = two_robot_tpg([(0, 2, 1, 1)])
    first, second = tpg.tasks
    kinds = (
        ("place-down", TaskKind.STRAIGHT)
        if kept
        else (TaskKind.HOLD, TaskKind.STRAIGHT)
    )
    own = [replace(second, index=k + 1, kind=kinds[k], object="ring") for k in (0, 1)]
    chain = replace(tpg.chains[1], task=np.array([1, 2, 2]))
    held = replace(tpg, tasks=(first, *own), chains=(tpg.chains[0], chain))
    for graph, state in ((held, HOLDING), (tpg, WAITING)):
        _, meanwhile, _ = robot_activities(graph, watched(graph)[1])["robot_1"]
        assert meanwhile.start_ns == NANOSECONDS
        assert meanwhile.end_ns == 3 * NANOSECONDS
        assert (meanwhile.state, meanwhile.task) == (state, 1)
    assert part_names(held)[1:] == ["ring", "ring"]


def test_bare_numbers_are_named_with_what_they_number() -> None:
    tpg = two_robot_tpg([(0, 2, 1, 1)])
    box = toy_cell((2,)).objects[0]
    box = replace(box, name="7")
    plain = replace(box, name="8", kind="8")
    cell = replace(tpg.cell, objects=(box, plain))
    first, second = tpg.tasks
    own = (
        replace(first, object="7", step=0),
        replace(second, object="8", step=1),
        replace(second, index=2, object=None, step=0),
        replace(second, index=3, object=None, step=5),
    )
    named = part_names(replace(tpg, cell=cell, tasks=own))
    assert named == ["2x4 7", "part 8", "2x4 7", "step 5"]
