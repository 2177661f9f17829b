"""Whole turns bring excursions together and change no pose."""

from __future__ import annotations

import numpy as np
import pytest

from planning.cell.workcell import PlacedRobot, Workcell
from planning.kinematics.kinematics import frame_pose
from planning.motion.transit import take_near_turns
from planning.robots.registry import robot_model
from planning.tasks.task import TRANSIT, StepTasks, Task


@pytest.fixture(scope="module")
def cell() -> Workcell:
    model = robot_model("gp4")
    return Workcell((PlacedRobot("arm", model, np.eye(4), model.home),), (), ())


def _step(cell: Workcell, wrists: list[list[float]]) -> StepTasks:
    """Excursions to the given wrist angles, HOME after each."""
    home = cell.robots[0].home
    tasks: list[Task] = []
    for wrist in wrists:
        for kind, angles in ((TRANSIT, wrist[:1]), ("pick", wrist[1:])):
            path = np.array([[0.2, 0.5, 0.0, 0.1, -1.0, angle] for angle in angles])
            tasks.append(Task(len(tasks), "arm", kind, 1, kind, path))
        tasks.append(Task(len(tasks), "arm", TRANSIT, 1, "HOME", home[None]))
    return StepTasks(1, tuple(tasks), (), ())


def test_the_second_excursion_turns_towards_the_first(cell: Workcell) -> None:
    step = _step(cell, [[-2.9, -3.0], [3.0, 3.1]])
    turned, reached = take_near_turns(cell, step, {})
    wrists = [task.path[:, 5].tolist() for task in turned.tasks]
    assert wrists[:2] == [[-2.9], [-3.0]]
    assert wrists[3][0] == pytest.approx(3.0 - 2 * np.pi)
    assert wrists[4][0] == pytest.approx(3.1 - 2 * np.pi)
    assert wrists[5] == [0.0]
    assert reached["arm"][5] == pytest.approx(3.1 - 2 * np.pi)


def test_poses_stay_what_they_were(cell: Workcell) -> None:
    step = _step(cell, [[2.0, 2.5], [-3.0, -2.5], [1.0, 1.1]])
    turned, _ = take_near_turns(cell, step, {"arm": np.full(6, 2.0)})
    model = cell.robots[0].model
    for before, after in zip(step.tasks, turned.tasks, strict=True):
        for q, p in zip(before.path, after.path, strict=True):
            assert np.allclose(
                frame_pose(cell.robots[0], q), frame_pose(cell.robots[0], p)
            )
            assert np.all(p >= model.lower)
            assert np.all(p <= model.upper)


def test_limits_forbid_a_turn(cell: Workcell) -> None:
    # The wrist reaches 450 degrees: 2 rad more than a turn is beyond it.
    step = _step(cell, [[2.0, 2.0]])
    turned, _ = take_near_turns(cell, step, {"arm": np.full(6, 8.0)})
    assert turned.tasks[0].path[0, 5] == 2.0
