"""Which task comes into which slot, given what gets into whose way."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest

from planning.cell.workcell import Workcell
from planning.errors import TransitError
from planning.motion.known_motions import MotionPlan, TaskMotion
from planning.motion.sequential import MotionSettings
from planning.motion.speed import L1Speed
from planning.tasks.task import Task
from scheduling.ordering.synchronous import SynchronousPlan, plan_synchronous
from tests.scheduling.mini_world import planar_cell


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

    def left_behind(self, first: int, task: int) -> bool:
        return (first, task) in self.left

    def not_yet_taken(self, task: int, later: int) -> bool:
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


def in_slots(
    plan: MotionPlan, conflicts: Written, *dependencies: tuple[int, int]
) -> SynchronousPlan:
    pairs = np.array(dependencies, dtype=np.int64).reshape(-1, 2)
    with_pairs = MotionPlan(plan.cell, plan.tasks, plan.motions, pairs, plan.allowed)
    speeds = {robot.name: L1Speed() for robot in plan.cell.robots}
    return plan_synchronous(with_pairs, MotionSettings({}, speeds, 0.05, {}), conflicts)


def test_robots_that_never_meet_all_work_in_every_slot() -> None:
    found = in_slots(skills(0, 0, 1, 1, 2, 2), Written())
    assert found.slot_of_task.tolist() == [0, 1, 0, 1, 0, 1]
    assert [float(m.time[0]) for m in found.motion_plan.motions] == [0, 2, 0, 2, 0, 2]


def test_a_task_waits_for_the_slot_after_what_it_depends_on() -> None:
    found = in_slots(skills(0, 1, 1), Written(), (0, 1))
    assert found.slot_of_task.tolist() == [0, 1, 2]


def test_skills_that_meet_follow_one_another_in_the_order_of_the_plan() -> None:
    found = in_slots(skills(1, 0), Written(swept={frozenset((0, 1))}))
    assert found.slot_of_task.tolist() == [0, 1]


def test_who_would_block_an_earlier_task_waits_until_it_is_done() -> None:
    # Where task 3 ends, arm1 would be in the way of task 2, which comes two slots later.
    found = in_slots(skills(0, 0, 0, 1), Written(held={("arm1", 3, 2)}))
    assert found.slot_of_task.tolist() == [0, 1, 2, 2]
    unhindered = in_slots(skills(0, 0, 0, 1), Written())
    assert unhindered.slot_of_task.tolist() == [0, 1, 2, 0]


def test_a_robot_that_stands_in_the_way_is_waited_for() -> None:
    # After task 0 arm0 stands in the way of task 4, and cannot go on before task 2 is done.
    plan = skills(0, 2, 2, 0, 1)
    meet = {frozenset((0, 4))}
    found = in_slots(plan, Written(meet, {("arm0", 0, 4)}), (2, 3))
    assert found.slot_of_task.tolist() == [0, 0, 1, 2, 2]
    assert in_slots(plan, Written(meet), (2, 3)).slot_of_task.tolist() == [
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
    found = in_slots(plan, Written())
    assert found.slot_of_task.tolist() == [0, 0, 1]
    assert found.motion_plan.motions[1].time.tolist() == [0.0, 7.0]
    assert found.motion_plan.motions[2].time.tolist() == [7.0, 9.0]


def test_a_sequential_plan_that_does_not_hold_is_refused_by_name() -> None:
    with pytest.raises(TransitError, match=r"task 1 \(skill 1\) of robot 'arm1'"):
        in_slots(skills(0, 1), Written({frozenset((0, 1))}, {("arm0", 0, 1)}))
