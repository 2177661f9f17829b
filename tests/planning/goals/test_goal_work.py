"""Goals of robots become steps: by joints or by pose, each checked before it is planned."""

import numpy as np
import pytest

from planning.errors import InfeasibleStepError
from planning.goals.goal_work import prepare_goals
from planning.goals.robot_goal import RobotGoal
from planning.kinematics.kinematics import frame_pose
from planning.motion.sequential import MotionSettings, plan_motions_sequentially
from planning.motion.speed import L1Speed
from planning.motion.transit import RrtConnect
from planning.tasks.highs_solver import assign_steps
from planning.transforms import Transform, from_rpy, translation
from tests.planning.parts.boxes import two_arms

CELL = two_arms()


def test_robots_go_where_they_are_told() -> None:
    pose = from_rpy([-0.1, 0.25, 0.3], [np.pi, 0.0, 0.5])
    joints = CELL.robots[1].home + 0.1
    goals = [RobotGoal("west", pose=pose), RobotGoal("east", joints=joints)]
    work, speed = prepare_goals(CELL, goals), L1Speed(1.0)
    transits = {
        robot.name: RrtConnect(robot.model.lower, robot.model.upper, speed)
        for robot in CELL.robots
    }
    settings = MotionSettings(transits, dict.fromkeys(transits, speed), 0.05, {})
    chosen = assign_steps(work.problem)
    _, plan = plan_motions_sequentially(CELL, work, chosen, settings)
    west, east = (motion.path[-1] for motion in plan.motions)
    assert np.allclose(frame_pose(CELL.robots[0], west, "tool"), pose, atol=1e-6)
    assert np.array_equal(east, joints)


@pytest.mark.parametrize(
    ("pose", "said"),
    [
        (translation(3.0, 0.0, 0.3), "out of reach"),
        (from_rpy([0.0, 0.0, -0.05], [np.pi, 0.0, 0.0]), "table"),
    ],
)
def test_a_goal_that_cannot_be_is_refused_with_why(pose: Transform, said: str) -> None:
    work = prepare_goals(CELL, [RobotGoal("west", pose=pose)])
    with pytest.raises(InfeasibleStepError, match=said):
        assign_steps(work.problem)
