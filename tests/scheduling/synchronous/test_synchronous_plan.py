"""Plans in slots: robots move at once where they can, and their graph keeps the guarantee."""

from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import cast

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.cell.workcell import Workcell, WorldState
from planning.errors import PlanInvariantError, TransitError
from planning.geometry.scene_checker import SceneChecker
from planning.joint_motion.moving_pairs import MovingPair
from planning.motion.motion_plan import MotionPlan, TaskMotion
from planning.motion.sequential import MotionSettings
from planning.motion.speed import L1Speed
from planning.motion.transit import RrtConnect
from planning.tasks.task import Task
from planning.transforms import Array
from scheduling.build_tpg import build_tpg
from scheduling.graph.barriers import with_barriers
from scheduling.graph.rollout import earliest_times
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.synchronous.composite import CompositeChecker
from scheduling.synchronous.synchronous_plan import (
    SynchronousPlan,
    TaskConflicts,
    plan_synchronous,
)
from tests.scheduling.algorithm_one import PlainGraph
from tests.scheduling.mini_world import planar_cell, random_plan
from tests.scheduling.random_dispatch import run_at_random

STEP = 0.15


def motion_settings(cell: Workcell, seed: int = 0) -> MotionSettings:
    speeds = {robot.name: L1Speed(1.0) for robot in cell.robots}
    planners = {
        robot.name: RrtConnect(robot.model.lower, robot.model.upper, speeds[robot.name])
        for robot in cell.robots
    }
    return MotionSettings(planners, speeds, STEP, {}, attempts=2, seed=seed)


def in_slots(plan: MotionPlan, seed: int = 0) -> SynchronousPlan:
    return plan_synchronous(plan, motion_settings(plan.cell, seed), TaskConflicts(plan))


def graph_of(plan: SynchronousPlan) -> TemporalPlanGraph:
    return replace(build_tpg(plan.motion_plan), slots=plan.slot_of_task)


def state_at(cell: Workcell, **q: Array) -> WorldState:
    state = cell.start_state()
    return WorldState({**state.configurations, **q}, state.attachments)


def kept_apart(cell: Workcell, path_a: Array, path_b: Array) -> bool:
    """Tell whether arm0 and arm1 keep the clearance at every sampled configuration."""
    for q_a, q_b in zip(path_a, path_b, strict=True):
        checker = SceneChecker(cell, "arm0", state_at(cell, arm1=q_b))
        if not checker.configuration_free(q_a):
            return False
    return True


def crossing(seed: int) -> tuple[Workcell, tuple[Array, Array, Array, Array]]:
    """Return two arms within each other's reach, and a motion of each."""
    rng = np.random.default_rng(seed)
    cell = planar_cell(2, rng, reach=0.45)
    first, second = (robot.model.dof for robot in cell.robots)
    q = [rng.uniform(-1.2, 1.2, dof) for dof in (first, first, second, second)]
    return cell, (q[0], q[1], q[2], q[3])


def between(q_a: Array, q_b: Array, share: Array) -> Array:
    return q_a + share[:, None] * (q_b - q_a)


class TestMovingPair:
    @given(st.integers(0, 10_000))
    @settings(max_examples=40, deadline=None)
    def test_what_it_calls_clear_is_clear_where_sampled_densely(
        self, seed: int
    ) -> None:
        cell, q = crossing(seed)
        parts = MovingPair(cell, "arm0", "arm1", cell.start_state()).split(*q, 12)
        if parts is None:
            return
        share = np.linspace(0.0, 1.0, 120)
        assert kept_apart(cell, between(*q[:2], share), between(*q[2:], share))
        assert parts[-1] == 1.0
        assert np.all(np.diff(parts, prepend=0.0) > 0.0)

    @given(st.integers(0, 10_000))
    @settings(max_examples=25, deadline=None)
    def test_in_a_part_each_robot_may_be_anywhere_on_its_own_stretch(
        self, seed: int
    ) -> None:
        cell, q = crossing(seed)
        parts = MovingPair(cell, "arm0", "arm1", cell.start_state()).split(*q, 10)
        if parts is None:
            return
        rng = np.random.default_rng(seed)
        for lo, hi in pairwise([0.0, *parts.tolist()]):
            x, y = rng.uniform(lo, hi, (2, 5))
            assert kept_apart(cell, between(*q[:2], x), between(*q[2:], y))

    def test_it_is_right_both_ways_where_there_is_a_little_room(self) -> None:
        answers = []
        share = np.linspace(0.0, 1.0, 120)
        for seed in range(60):
            cell, q = crossing(seed)
            pair = MovingPair(cell, "arm0", "arm1", cell.start_state())
            found = pair.split(*q, 40) is not None
            roomy = replace(cell.clearances, robot_robot=0.03)
            wide = replace(cell, clearances=roomy)
            if kept_apart(wide, between(*q[:2], share), between(*q[2:], share)):
                assert found
            answers.append(found)
        assert 5 < sum(answers) < 55

    def test_parts_are_halved_where_the_robots_come_near(self) -> None:
        halved = 0
        for seed in range(100):
            cell, q = crossing(seed)
            parts = MovingPair(cell, "arm0", "arm1", cell.start_state()).split(*q, 1)
            halved += parts is not None and len(parts) > 1
        assert halved > 0

    def test_allowed_contacts_are_not_looked_at(self) -> None:
        cell, q = next(
            found
            for found in map(crossing, range(100))
            if MovingPair(found[0], "arm0", "arm1", found[0].start_state()).split(
                *found[1], 8
            )
            is None
        )
        groups = [
            f"{arm}/{group}" for arm in ("arm0", "arm1") for group in ("arm", "tool")
        ]
        allowed = frozenset(frozenset((x, y)) for x in groups for y in groups)
        pair = MovingPair(cell, "arm0", "arm1", cell.start_state(), allowed)
        assert pair.split(*q, 8) is not None


def test_composite_parts_are_no_longer_than_a_step() -> None:
    rng = np.random.default_rng(4)
    cell = planar_cell(2, rng)
    speeds = {"arm0": L1Speed(1.0), "arm1": L1Speed(0.5)}
    checker = CompositeChecker(
        cell, {"arm0": 0, "arm1": 1}, cell.start_state(), {}, (), speeds, step=0.1
    )
    start = np.concatenate([robot.home for robot in cell.robots])
    goal = start + 0.2
    motions = checker.motions(np.array([start, goal]))
    assert motions is not None
    times = motions["arm0"].time
    dof = cell.robots[1].model.dof
    assert times[-1] == pytest.approx(dof * 0.2 / 0.5)
    assert np.all(np.diff(times) < 0.1 + 1e-9)
    assert np.array_equal(times, motions["arm1"].time)


@pytest.mark.parametrize("robots", [2, 3, 4])
@pytest.mark.parametrize("seed", range(2))
def test_slots_keep_order_and_the_graph_keeps_the_guarantee(
    robots: int, seed: int
) -> None:
    plan = random_plan(robots, seed, rounds=6)
    slots = in_slots(plan)
    of = dict(
        zip((t.index for t in plan.tasks), slots.slot_of_task.tolist(), strict=True)
    )
    still = {
        task.index
        for task, motion in zip(plan.tasks, plan.motions, strict=True)
        if not np.any(np.diff(motion.path, axis=0))
    }
    for a, b in plan.dependencies.tolist():
        assert of[a] < of[b] or (of[a] == of[b] and a in still)
    for robot in plan.cell.robots:
        own = [t.index for t in plan.tasks if t.robot == robot.name]
        for a, b in pairwise(own):
            assert of[a] < of[b] or a in still
    tpg = graph_of(slots)  # build_tpg checks the invariant itself
    plain = PlainGraph(tpg)
    met: set[tuple[object, object]] = set()
    for _ in range(2):
        run_at_random(tpg, plain, np.random.default_rng(seed), met)
    planned = max(float(m.time[-1]) for m in slots.motion_plan.motions)
    before = max(float(m.time[-1]) for m in plan.motions)
    assert planned <= before + 1e-3 * len(plan.tasks)
    assert earliest_times(tpg).makespan <= planned + 1e-6


def test_tasks_end_where_they_ended_in_the_sequential_plan() -> None:
    plan = random_plan(3, 7)
    slots = in_slots(plan)
    for before, after in zip(plan.motions, slots.motion_plan.motions, strict=True):
        assert np.allclose(before.path[0], after.path[0])
        assert np.allclose(before.path[-1], after.path[-1])


def test_some_are_planned_as_one_robot_and_move_in_lock_step() -> None:
    joint: list[tuple[int, ...]] = []
    for seed in range(12):
        plan = random_plan(3, seed, rounds=10, objects=0)
        slots = in_slots(plan)
        index = {task.index: k for k, task in enumerate(plan.tasks)}
        for group in slots.jointly_planned:
            times = [slots.motion_plan.motions[index[task]].time for task in group]
            assert len(group) > 1
            assert all(np.array_equal(times[0], other) for other in times)
        joint += slots.jointly_planned
        graph_of(slots)
    assert joint


def test_the_same_seed_gives_the_same_slots() -> None:
    plan = random_plan(3, 2, rounds=10, objects=0)
    first, second = in_slots(plan), in_slots(plan)
    assert np.array_equal(first.slot_of_task, second.slot_of_task)
    for a, b in zip(first.motion_plan.motions, second.motion_plan.motions, strict=True):
        assert np.array_equal(a.path, b.path)
        assert np.array_equal(a.time, b.time)


@pytest.mark.parametrize("robots", [2, 4])
def test_nobody_enters_a_slot_before_all_have_left_the_one_before(robots: int) -> None:
    tpg = graph_of(in_slots(random_plan(robots, 5)))
    rng = np.random.default_rng(0)
    of = np.zeros(1 + max(t.index for t in tpg.tasks), dtype=np.int64)
    of[[t.index for t in tpg.tasks]] = tpg.slots
    for _ in range(5):
        durations = [rng.uniform(0.0, 5.0, len(chain)) for chain in tpg.chains]
        times = earliest_times(with_barriers(tpg), durations)
        start = np.concatenate(times.start)
        end = np.concatenate(times.end)
        slot = np.concatenate([of[chain.task] for chain in tpg.chains])
        for number in range(1, int(slot.max()) + 1):
            before, now = slot < number, slot == number
            if before.any() and now.any():
                assert start[now].min() >= end[before].max() - 1e-9


def test_a_plan_without_slots_has_no_barriers() -> None:
    with pytest.raises(PlanInvariantError, match="not made in slots"):
        with_barriers(build_tpg(random_plan(2, 1)))


@dataclass
class Written:
    """Conflicts as a test writes them down."""

    swept: set[frozenset[int]] = field(default_factory=set)
    held: set[tuple[str, int | None, int]] = field(default_factory=set)
    left: set[tuple[int, int]] = field(default_factory=set)
    there: set[tuple[int, int]] = field(default_factory=set)

    def sweeps(self, first: int, second: int) -> bool:
        return frozenset((first, second)) in self.swept

    def hold(self, robot: str, after: int | None, task: int) -> bool:
        return (robot, after, task) in self.held

    def meets_left_object(self, first: int, task: int) -> bool:
        return (first, task) in self.left

    def meets_untaken_object(self, task: int, later: int) -> bool:
        return (task, later) in self.there


def skills(*robots: int, seconds: float = 2.0) -> MotionPlan:
    """One skill after another, each of the arm whose number is given."""
    cell: Workcell = planar_cell(1 + max(robots), np.random.default_rng(0))
    at = {robot.name: robot.home for robot in cell.robots}
    tasks, motions = [], []
    for index, number in enumerate(robots):
        name = f"arm{number}"
        path = np.stack([at[name], at[name] + 0.1])
        at[name] = path[-1]
        tasks.append(Task(index, name, "pick", 1, f"skill {index}", path[1:]))
        times = np.array([index, index + 1]) * seconds
        motions.append(TaskMotion(path, times))
    return MotionPlan(
        cell, tuple(tasks), tuple(motions), np.empty((0, 2), dtype=np.int64), ()
    )


def with_conflicts(
    plan: MotionPlan, conflicts: Written, *dependencies: tuple[int, int]
) -> SynchronousPlan:
    pairs = np.array(dependencies, dtype=np.int64).reshape(-1, 2)
    with_pairs = MotionPlan(plan.cell, plan.tasks, plan.motions, pairs, plan.allowed)
    speeds = {robot.name: L1Speed() for robot in plan.cell.robots}
    return plan_synchronous(
        with_pairs,
        MotionSettings({}, speeds, 0.05, {}),
        cast(TaskConflicts, conflicts),
    )


def test_robots_that_never_meet_all_work_in_every_slot() -> None:
    found = with_conflicts(skills(0, 0, 1, 1, 2, 2), Written())
    assert found.slot_of_task.tolist() == [0, 1, 0, 1, 0, 1]
    assert [float(m.time[0]) for m in found.motion_plan.motions] == [0, 2, 0, 2, 0, 2]


def test_a_task_waits_for_the_slot_after_what_it_depends_on() -> None:
    found = with_conflicts(skills(0, 1, 1), Written(), (0, 1))
    assert found.slot_of_task.tolist() == [0, 1, 2]


def test_skills_that_meet_follow_one_another_in_the_order_of_the_plan() -> None:
    found = with_conflicts(skills(1, 0), Written(swept={frozenset((0, 1))}))
    assert found.slot_of_task.tolist() == [0, 1]


def test_who_would_block_an_earlier_task_waits_until_it_is_done() -> None:
    # Where task 3 ends, arm1 would be in the way of task 2, which comes two slots later.
    found = with_conflicts(skills(0, 0, 0, 1), Written(held={("arm1", 3, 2)}))
    assert found.slot_of_task.tolist() == [0, 1, 2, 2]
    unhindered = with_conflicts(skills(0, 0, 0, 1), Written())
    assert unhindered.slot_of_task.tolist() == [0, 1, 2, 0]


def test_a_robot_that_stands_in_the_way_is_waited_for() -> None:
    # After task 0 arm0 stands in the way of task 4, and cannot go on before task 2 is done.
    plan = skills(0, 2, 2, 0, 1)
    meet = {frozenset((0, 4))}
    found = with_conflicts(plan, Written(meet, {("arm0", 0, 4)}), (2, 3))
    assert found.slot_of_task.tolist() == [0, 0, 1, 2, 2]
    assert with_conflicts(plan, Written(meet), (2, 3)).slot_of_task.tolist() == [
        0,
        0,
        1,
        2,
        1,
    ]


def test_a_slot_lasts_as_long_as_its_longest_task() -> None:
    plan = skills(0, 1, 0)
    longer = TaskMotion(plan.motions[1].path, np.array([2.0, 9.0]))
    motions = (plan.motions[0], longer, plan.motions[2])
    plan = MotionPlan(plan.cell, plan.tasks, motions, plan.dependencies, ())
    found = with_conflicts(plan, Written())
    assert found.slot_of_task.tolist() == [0, 0, 1]
    assert found.motion_plan.motions[1].time.tolist() == [0.0, 7.0]
    assert found.motion_plan.motions[2].time.tolist() == [7.0, 9.0]


def test_a_sequential_plan_that_does_not_hold_is_refused_by_name() -> None:
    with pytest.raises(TransitError, match=r"task 1 \(skill 1\) of robot 'arm1'"):
        with_conflicts(skills(0, 1), Written({frozenset((0, 1))}, {("arm0", 0, 1)}))
