"""Sequential planning with two arms that reach for boxes, other ways tried when one fails."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from planning.cell.shape import box_shape
from planning.cell.workcell import CellObject, PlacedRobot, Workcell
from planning.errors import TransitError
from planning.geometry.scene_checker import Contact, SceneChecker
from planning.kinematics.kinematics import frame_pose
from planning.motion.full_turns import take_near_turns
from planning.motion.motion_plan import MotionPlan
from planning.motion.sequential import (
    MotionSettings,
    explain_blockage,
    plan_motions_sequentially,
)
from planning.motion.speed import L1Speed
from planning.motion.transit import RrtConnect
from planning.robots.registry import robot_model
from planning.tasks.task import AllowedContact, Handling, StepTasks, Task, TaskKind
from planning.transforms import Array, from_rpy, inverse, translation

SIZE = np.array([0.016, 0.032, 0.0096])
REACH = np.array([0.5, 0.3, 0.1, 0.0, -0.2, 0.0])


@pytest.fixture(scope="module")
def cell() -> Workcell:
    model = robot_model("gp4")
    left = PlacedRobot("left", model, np.eye(4), model.home)
    right = PlacedRobot(
        "right", model, from_rpy((0.88, 0, 0), (0, 0, np.pi)), model.home
    )
    at = frame_pose(left, model.home + REACH) @ translation(0, 0, 0.12)
    box = CellObject("box", "box", box_shape("box", SIZE), at)
    return Workcell((left, right), (), (box,))


def _settings(cell: Workcell, seed: int) -> MotionSettings:
    speed = L1Speed()
    return MotionSettings(
        {
            r.name: RrtConnect(r.model.lower, r.model.upper, speed, checks=300)
            for r in cell.robots
        },
        {r.name: speed for r in cell.robots},
        0.05,
        {"pick": 4.0},
        2,
        seed,
    )


def _no_links(steps: Sequence[StepTasks]) -> npt.NDArray[np.int64]:
    pairs = [pair for step in steps for pair in step.dependencies]
    return np.array(pairs, dtype=np.int64).reshape(-1, 2)


def _fetch(cell: Workcell, first: int, reach: Array = REACH) -> StepTasks:
    """The left arm goes to the box, takes it and brings it HOME."""
    robot = cell.robots[0]
    here = robot.home + reach
    lifted = here + np.array([0, -0.05, 0, 0, 0, 0])
    grip = inverse(frame_pose(robot, here)) @ cell.objects[0].start
    take = Handling("box", 1, "left", grip)
    ahead = robot.home + reach * 0.9
    tasks = (
        Task(first, "left", TaskKind.TRANSIT, 1, "to box", ahead[None]),
        Task(
            first + 1, "left", "pick", 1, "pick box", np.array([here, lifted]), (take,)
        ),
        Task(first + 2, "left", TaskKind.TRANSIT, 1, "HOME", robot.home[None]),
    )
    contact = AllowedContact("left/tool", "box", frozenset(range(first, first + 3)))
    return StepTasks(1, tasks, ((first, first + 2),), (contact,))


def _plan(cell: Workcell, *reach: Array, seed: int = 0, **changes: Any) -> MotionPlan:
    """The plan of one step, the first of its ways that can be."""
    ways = reach or (REACH,)
    return plan_motions_sequentially(
        cell,
        [lambda first: (_fetch(cell, first, way) for way in ways)],
        _no_links,
        replace(_settings(cell, seed), **changes),
    )


def test_paths_join_times_rise_and_the_box_comes_along(cell: Workcell) -> None:
    plan = _plan(cell)
    assert [task.index for task in plan.tasks] == [0, 1, 2]
    assert plan.dependencies.tolist() == [[0, 2]]
    end = cell.robots[0].home
    clock = 0.0
    for motion in plan.motions:
        assert np.allclose(motion.path[0], end)
        assert motion.time[0] == clock
        assert np.all(np.diff(motion.time) >= 0)
        end, clock = motion.path[-1], motion.time[-1]
    assert plan.motions[1].time[-1] - plan.motions[1].time[0] == pytest.approx(4.0)
    transit = plan.motions[0]
    assert np.max(np.diff(transit.time)) <= 0.05 + 1e-12
    rate = np.abs(np.diff(transit.path, axis=0)).sum(axis=1) / np.diff(transit.time)
    assert np.allclose(rate, 1.0)
    checker = SceneChecker(cell, "left", cell.start_state())
    assert all(checker.motion_free(a, b) for a, b in pairwise(transit.path))


BENT = np.array([0.0, 2.2, 3.4, 0.0, 0.0, 0.0])
"""A goal that puts the forearm into the arm's own base."""


def test_another_way_is_tried_when_the_first_one_is_blocked(cell: Workcell) -> None:
    plan = _plan(cell, BENT, REACH)
    assert np.allclose(plan.motions[1].path[1], cell.robots[0].home + REACH)


def test_when_all_ways_fail_the_error_names_task_robot_and_step(cell: Workcell) -> None:
    with pytest.raises(TransitError, match=r"step 1, task 0 \(to box\) .*'left'"):
        _plan(cell, BENT)


def test_the_same_seed_gives_the_same_plan(cell: Workcell) -> None:
    one, two = (_plan(cell, seed=5) for _ in range(2))
    for a, b in zip(one.motions, two.motions, strict=True):
        assert np.array_equal(a.path, b.path)
        assert np.array_equal(a.time, b.time)


class _Wall:
    """A point that must not come nearer than 0.098 to a wall where its first joint is 0.5."""

    def contact(self, q: Array) -> Contact | None:
        gap = abs(float(q[0]) - 0.5)
        return None if gap >= 0.098 else Contact("arm/tool:tip", "wall", gap, 0.098)


class _Cage:
    """A point that is free at zero and nowhere else."""

    def contact(self, q: Array) -> Contact | None:
        far = float(np.abs(q).max())
        return None if far == 0.0 else Contact("arm/tool:tip", "cage", -0.1 * far, 0.0)


def test_what_is_in_the_way_of_a_transit_is_said_with_how_near_it_is() -> None:
    start, goal = np.zeros(3), np.array([1.0, 0.2, 0.0])
    words, contact = explain_blockage(_Wall(), start, goal)
    assert contact is not None
    assert contact.obstacle == "wall"
    assert words == (
        "straight on, arm/tool:tip and wall come within 95.0 mm after 40 % of the way"
    )
    words, _ = explain_blockage(_Cage(), start, goal)
    assert words == (
        "at its start no joint can turn by 0.05 rad or m: then arm/tool:tip and cage"
        " overlap by 5.0 mm"
    )


class _NoPlanner:
    def plan(self, *_: object) -> None:
        return None


def test_a_transit_without_a_path_says_what_is_in_its_way(cell: Workcell) -> None:
    planners = dict.fromkeys(("left", "right"), _NoPlanner())
    with pytest.raises(TransitError, match="found with 2 seeds; straight on"):
        _plan(cell, planners=planners)


@pytest.fixture(scope="module")
def turning_cell() -> Workcell:
    model = robot_model("gp4")
    return Workcell((PlacedRobot("arm", model, np.eye(4), model.home),), (), ())


def _step(turning_cell: Workcell, wrists: list[list[float]]) -> StepTasks:
    """Excursions to the given wrist angles, HOME after each."""
    home = turning_cell.robots[0].home
    tasks: list[Task] = []
    for wrist in wrists:
        for kind, angles in ((TaskKind.TRANSIT, wrist[:1]), ("pick", wrist[1:])):
            path = np.array([[0.2, 0.5, 0.0, 0.1, -1.0, angle] for angle in angles])
            tasks.append(Task(len(tasks), "arm", kind, 1, kind, path))
        tasks.append(Task(len(tasks), "arm", TaskKind.TRANSIT, 1, "HOME", home[None]))
    return StepTasks(1, tuple(tasks), (), ())


def test_the_second_excursion_turns_towards_the_first(turning_cell: Workcell) -> None:
    step = _step(turning_cell, [[-2.9, -3.0], [3.0, 3.1]])
    turned, reached = take_near_turns(turning_cell, step, {})
    wrists = [task.path[:, 5].tolist() for task in turned.tasks]
    assert wrists[:2] == [[-2.9], [-3.0]]
    assert wrists[3][0] == pytest.approx(3.0 - 2 * np.pi)
    assert wrists[4][0] == pytest.approx(3.1 - 2 * np.pi)
    assert wrists[5] == [0.0]
    assert reached["arm"][5] == pytest.approx(3.1 - 2 * np.pi)


def test_poses_stay_what_they_were(turning_cell: Workcell) -> None:
    step = _step(turning_cell, [[2.0, 2.5], [-3.0, -2.5], [1.0, 1.1]])
    turned, _ = take_near_turns(turning_cell, step, {"arm": np.full(6, 2.0)})
    model = turning_cell.robots[0].model
    for before, after in zip(step.tasks, turned.tasks, strict=True):
        for q, p in zip(before.path, after.path, strict=True):
            assert np.allclose(
                frame_pose(turning_cell.robots[0], q),
                frame_pose(turning_cell.robots[0], p),
            )
            assert np.all(p >= model.lower)
            assert np.all(p <= model.upper)


def test_limits_forbid_a_turn(turning_cell: Workcell) -> None:
    # The wrist reaches 450 degrees: 2 rad more than a turn is beyond it.
    step = _step(turning_cell, [[2.0, 2.0]])
    turned, _ = take_near_turns(turning_cell, step, {"arm": np.full(6, 8.0)})
    assert turned.tasks[0].path[0, 5] == 2.0
