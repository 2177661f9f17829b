"""Goals of robots become steps: by joints or by pose, each checked before it is planned."""

from __future__ import annotations

import numpy as np
import pytest

from planning.cell.shape import box_shape
from planning.cell.workcell import Fixture, PlacedRobot, Workcell
from planning.errors import InfeasibleStepError
from planning.kinematics.kinematics import frame_pose
from planning.motion.sequential import MotionSettings, plan_sequential
from planning.motion.speed import L1Speed
from planning.motion.transit import RrtConnect
from planning.robots.registry import robot_model
from planning.steps.robot_goals import RobotGoal, prepare_goals
from planning.tasks.highs_solver import assign_steps
from planning.tasks.work import AssemblyWork, StepExpansions
from planning.transforms import from_rpy, translation


@pytest.fixture(scope="module")
def cell() -> Workcell:
    model = robot_model("panda")
    size = np.array([1.6, 1.2, 0.04])
    table = Fixture("table", box_shape("table", size), translation(0, 0, -0.02))
    return Workcell(
        (
            PlacedRobot("west", model, translation(-0.5, 0.0, 0.0), model.home),
            PlacedRobot(
                "east", model, from_rpy([0.5, 0, 0], [0, 0, np.pi]), model.home
            ),
        ),
        (table,),
        (),
    )


def plan_of(cell: Workcell, work: AssemblyWork) -> list[np.ndarray]:
    speed = L1Speed(1.0)
    settings = MotionSettings(
        {
            robot.name: RrtConnect(robot.model.lower, robot.model.upper, speed)
            for robot in cell.robots
        },
        {robot.name: speed for robot in cell.robots},
        0.05,
        {},
    )
    steps = StepExpansions(work, assign_steps(work.problem))
    plan = plan_sequential(cell, steps.callables(), work.link, settings)
    return [motion.path[-1] for motion in plan.motions]


def test_robots_go_where_they_are_told(cell: Workcell) -> None:
    pose = from_rpy([-0.1, 0.25, 0.3], [np.pi, 0.0, 0.5])
    joints = cell.robots[1].home + 0.1
    goals = [RobotGoal("west", pose=pose), RobotGoal("east", joints=joints)]
    ends = plan_of(cell, prepare_goals(cell, goals))
    assert np.allclose(frame_pose(cell.robots[0], ends[0], "tool"), pose, atol=1e-6)
    assert np.array_equal(ends[1], joints)


def test_a_goal_out_of_reach_is_named(cell: Workcell) -> None:
    work = prepare_goals(cell, [RobotGoal("west", pose=translation(3.0, 0.0, 0.3))])
    with pytest.raises(InfeasibleStepError, match="out of reach"):
        assign_steps(work.problem)


def test_a_goal_in_the_table_names_the_table(cell: Workcell) -> None:
    down = from_rpy([0.0, 0.0, -0.05], [np.pi, 0.0, 0.0])
    work = prepare_goals(cell, [RobotGoal("west", pose=down)])
    with pytest.raises(InfeasibleStepError, match="table"):
        assign_steps(work.problem)
