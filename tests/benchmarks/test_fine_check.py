"""The fine check: good plans pass, and whatever is done to one is found."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.construction.fine_check.check import check_construction, timeline_faults
from benchmarks.construction.fine_check.clearance import ClearanceCheck
from benchmarks.construction.fine_check.timed_motion import (
    MovingRobot,
    TimedMotion,
    piece_times,
)
from benchmarks.construction.fixed_time import plan_fixed_time
from planning.construction.planner import ConstructionPlan, plan_construction
from planning.construction.problem.models import tower
from planning.construction.world.timeline import ObjectTimeline, RobotTimeline
from planning.robots.registry import robot_model
from planning.transforms import Array, read_only_copy, rotation, translation
from scheduling.witness.parts import measure
from scheduling.witness.robot import WitnessRobot
from tests.planning.construction.toy_sites import toy_problem
from tests.planning.construction.toy_teams import placed, rover

PROBLEM = toy_problem(tower(2), 2)


@cache
def good() -> ConstructionPlan:
    return plan_construction(PROBLEM)


def with_line(plan: ConstructionPlan, line: RobotTimeline) -> ConstructionPlan:
    world = plan.building.world.with_robot(line)
    return replace(plan, building=replace(plan.building, world=world))


def with_object(plan: ConstructionPlan, line: ObjectTimeline) -> ConstructionPlan:
    world = plan.building.world.with_object(line)
    return replace(plan, building=replace(plan.building, world=world))


def driving(plan: ConstructionPlan, robot: str, *to: Array) -> ConstructionPlan:
    """Return the plan in which a robot goes somewhere when it has done its work."""
    line = plan.building.world.robots[robot]
    path = np.vstack([line.path[-1:], *(q[None] for q in to)])
    time: Array = line.end + 60.0 + 60.0 * np.arange(float(len(path)))
    return with_line(plan, line.then(time, path))


def test_a_good_plan_passes() -> None:
    assert good().rewound == 0
    found = check_construction(good())
    assert found.ok, found.faults[:3]
    assert timeline_faults(good()) == []
    assert found.measured > 10
    assert 0.0 <= found.least_others_m < 0.05


def test_the_fixed_time_baseline_passes() -> None:
    plan = plan_fixed_time(PROBLEM, 6.0)
    found = check_construction(plan)
    assert found.ok, found.faults[:3]
    starts = {
        robot: [w for w in plan.building.work if w.robot == robot]
        for robot in PROBLEM.team
    }
    for work in starts.values():
        end = 0.0
        for skill in work:
            waits = (skill.start - end) / 6.0
            assert waits == pytest.approx(round(waits))
            assert waits > 0.5
            end = skill.end


def test_the_whole_check_finds_what_is_wrong_with_timelines_too() -> None:
    plan = into_the_other(misplaced(good()))
    faults = check_construction(plan).faults
    assert {fault.kind for fault in faults} == {"pose", "clearance"}
    assert any("robot1/arm and robot2/arm" in fault.words for fault in faults)
    assert set(timeline_faults(plan)) < set(faults)
    assert [f.t for f in faults] == sorted(f.t for f in faults)


def late_robot(plan: ConstructionPlan) -> ConstructionPlan:
    line = plan.building.world.robots["robot1"]
    return with_line(plan, replace(line, time=line.time + np.minimum(line.time, 4.0)))


def late_hand(plan: ConstructionPlan) -> ConstructionPlan:
    """Everything that robot1 does, and what that does to parts, comes much later."""
    by = 200.0
    building = plan.building
    line = building.world.robots["robot1"]
    plan = with_line(
        plan,
        replace(
            line,
            time=np.concatenate([[0.0], line.time + by]),
            path=np.vstack([line.path[:1], line.path]),
            busy_until=line.busy_until + by,
        ),
    )
    own = {w.object for w in building.work if w.robot == "robot1"}
    for name in own:
        assert name is not None
        item = plan.building.world.objects[name]
        later = tuple(c._replace(time=c.time + by) for c in item.changes)
        plan = with_object(plan, replace(item, changes=later))
    work = tuple(
        replace(w, time=w.time + by) if w.robot == "robot1" else w
        for w in building.work
    )
    return replace(plan, building=replace(plan.building, work=work))


def exchanged_parts(plan: ConstructionPlan) -> ConstructionPlan:
    world = plan.building.world
    plan = with_object(plan, replace(world.objects["beam1"], object="beam2"))
    return with_object(plan, replace(world.objects["beam2"], object="beam1"))


def hurried(plan: ConstructionPlan) -> ConstructionPlan:
    line = plan.building.world.robots["robot2"]
    moves = np.any(np.diff(line.path, axis=0) != 0.0, axis=1)
    k = int(np.flatnonzero(moves)[0]) + 1
    time = np.array(line.time)
    time[k] = time[k - 1] + 0.9 * (time[k] - time[k - 1])
    return with_line(plan, replace(line, time=time))


def through_the_tower(plan: ConstructionPlan) -> ConstructionPlan:
    home = plan.building.world.robots["robot1"].path[-1]
    there = np.array(home)
    there[:2] *= -1.0
    # The other one has left meanwhile: the way is blocked by the tower alone.
    aside = np.array(plan.building.world.robots["robot2"].path[-1])
    aside[:2] = -8.0, 8.0
    return driving(driving(plan, "robot2", aside), "robot1", home, home, there)


def into_the_other(plan: ConstructionPlan) -> ConstructionPlan:
    home = plan.building.world.robots["robot1"].path[-1]
    aside, there = np.array(home), np.array(home)
    aside[1] = 8.0
    there[:2] = -5.0, 8.0
    over = np.array(there)
    over[1] = 0.0
    return driving(plan, "robot1", aside, there, over)


def turned_grip(plan: ConstructionPlan) -> ConstructionPlan:
    """The part is held upside down, and put down so."""
    world = plan.building.world
    item = world.objects["beam2"]
    first = item.changes[0]
    pose = read_only_copy(first.pose @ rotation("x", np.pi))
    return with_object(
        plan, replace(item, changes=(first._replace(pose=pose), *item.changes[1:]))
    )


def misplaced(plan: ConstructionPlan) -> ConstructionPlan:
    item = plan.building.world.objects["beam2"]
    last = item.changes[-1]
    pose = read_only_copy(translation(0.0, 0.002, 0.0) @ last.pose)
    return with_object(
        plan, replace(item, changes=(*item.changes[:-1], last._replace(pose=pose)))
    )


def forgotten_pick(plan: ConstructionPlan) -> ConstructionPlan:
    building = plan.building
    first = next(w for w in building.work if w.object == "beam2")
    work = tuple(w for w in building.work if w is not first)
    return replace(plan, building=replace(building, work=work))


def short_skill(plan: ConstructionPlan) -> ConstructionPlan:
    building = plan.building
    work = tuple(
        replace(w, time=np.maximum(w.time, w.touch - 0.1)) if w.object == "beam2" else w
        for w in building.work
    )
    return replace(plan, building=replace(building, work=work))


def overlapping_skills(plan: ConstructionPlan) -> ConstructionPlan:
    """The pick of a part goes on until after its place has begun."""
    building = plan.building
    place = next(w for w in building.work if w.holder is None)
    work = tuple(
        replace(w, time=np.append(w.time[:-1], place.start + 0.1))
        if w.object == place.object and w is not place
        else w
        for w in building.work
    )
    return replace(plan, building=replace(building, work=work))


def bent_joint(plan: ConstructionPlan) -> ConstructionPlan:
    model = robot_model("mobile-manipulator")
    beyond = np.array(plan.building.world.robots["robot1"].path[-1])
    beyond[3] = model.upper[3] + 0.01
    return driving(plan, "robot1", beyond)


@pytest.mark.parametrize(
    ("tamper", "kind", "words"),
    [
        (late_robot, "pose", "jumps by"),
        (late_hand, "order", "is placed before"),
        (exchanged_parts, "mode", "not when the part changes hands"),
        (hurried, "motion", "robot2 moves joint"),
        (through_the_tower, "clearance", "robot1/arm and beam"),
        (turned_grip, "mode", "by none of its grips"),
        (misplaced, "pose", "beam2 ends 2.0 mm from where it belongs"),
        (forgotten_pick, "mode", "beam2 goes through place-down"),
        (short_skill, "mode", "less than"),
        (overlapping_skills, "mode", "begins place"),
        (bent_joint, "motion", "beyond its joint limits"),
    ],
)
def test_a_tampered_plan_is_refused(
    tamper: Callable[[ConstructionPlan], ConstructionPlan], kind: str, words: str
) -> None:
    plan = tamper(good())
    if kind == "clearance":
        checked = check_construction(plan)
        assert not checked.ok
        found = list(checked.faults)
    else:  # without all the measuring
        found = timeline_faults(plan)
    hits = [fault for fault in found if words in fault.words]
    assert hits, found[:5]
    assert {fault.kind for fault in hits} == {kind}


@settings(max_examples=6, deadline=None)
@given(st.integers(0, 100_000))
def test_what_samples_show_is_found(seed: int) -> None:
    """Oracle: distances of all bodies at many moments."""
    rng = np.random.default_rng(seed)
    motions = []
    for name, at in (("a", -0.6), ("b", 0.6)):
        robot = placed(name, rover(), (at, 0.0, 0.0, 0.0, 0.0))
        path = np.zeros((4, 5))
        path[:, :2] = rng.uniform(-0.9, 0.9, (4, 2))
        path[:, 2:] = rng.uniform(-1.0, 1.0, (4, 3))
        time = np.cumsum(rng.uniform(0.5, 2.0, 4))
        line = RobotTimeline(name, time, path)
        motions.append(TimedMotion(WitnessRobot(robot), line))
    both = [(motion, motion.robot.parts) for motion in motions]
    times = piece_times(both, 0.0, 9.0)
    check, least = ClearanceCheck(), float(rng.choice([0.0, 0.02]))
    robots = [MovingRobot(motion, parts, times) for motion, parts in both]
    check.between(robots[0], robots[1], times, lambda p, q: least)
    looked = np.linspace(0.0, 9.0, 400)
    frames = [m.robot.joint_frames_along(m.at(looked)) for m, _ in both]
    close: dict[tuple[str, str], float] = {}
    for p in robots[0].parts:
        for q in robots[1].parts:
            ends = frames[0][:, p.joint + 1], frames[1][:, q.joint + 1]
            gap = np.array([measure(p, f, q, g) for f, g in zip(*ends, strict=True)])
            if np.any(gap < least - 3e-5):
                key = (p.entity, q.entity)
                first = float(looked[np.argmax(gap < least - 3e-5)])
                close[key] = min(close.get(key, np.inf), first)
    found: dict[tuple[str, str], float] = {}
    for t, words in check.found:
        one, _, rest = words.partition(" and ")
        key = (one, rest.partition(":")[0])
        found[key] = min(found.get(key, np.inf), t)
    assert set(close) <= set(found)
    assert all(found[key] <= t for key, t in close.items())
