"""Two arms of one joint each that sweep the same corner."""

import numpy as np

from planning.cell.workcell import Clearances, PlacedRobot, Workcell
from planning.motion.known_motions import MotionPlan, TaskMotion
from planning.tasks.task import Task
from planning.transforms import rotation, translation
from tests.scheduling.mini_world import planar_arm


def two_arms() -> Workcell:
    arm = planar_arm(1)
    robots = (
        PlacedRobot("left", arm, translation(0.0, 0.0, 0.0), np.zeros(1)),
        PlacedRobot(
            "right",
            arm,
            translation(0.45, 0.0, 0.0) @ rotation("z", np.pi),
            np.zeros(1),
        ),
    )
    return Workcell(robots, (), (), Clearances(0.001, 0.0))


def one_joint_plan(*moves: tuple[str, list[float]]) -> MotionPlan:
    """Sequential transits of one-joint arms through the given angles, 1 s a waypoint."""
    tasks, motions, time = [], [], 0.0
    for index, (robot, angles) in enumerate(moves):
        path = np.array(angles)[:, None]
        times = time + np.arange(len(path), dtype=float)
        time = float(times[-1])
        tasks.append(Task(index, robot, "transit", 1, f"move {index}", path[1:]))
        motions.append(TaskMotion(path, times))
    none = np.empty((0, 2), dtype=np.int64)
    return MotionPlan(two_arms(), tuple(tasks), tuple(motions), none, ())
