"""Motion plans of two GP4 arms that take turns around one spot between them."""

from dataclasses import replace

import numpy as np

from planning.cell.shape import box_shape
from planning.cell.workcell import (
    Attachment,
    CellObject,
    Fixture,
    PlacedRobot,
    Workcell,
    WorldState,
)
from planning.geometry.scene_checker import SceneChecker
from planning.motion.motion_plan import MotionPlan, TaskMotion
from planning.robots.registry import robot_model
from planning.tasks.task import Handling, Task
from planning.transforms import Array, Transform, from_rpy, translation
from tests.scheduling.mini_world import PlanWriter

STEP = 0.05
"""L1 distance of two nodes [rad], at 1 rad/s."""


def block(name: str, size: tuple[float, float, float], pose: Transform) -> CellObject:
    return CellObject(name, "block", box_shape(name, size), pose)


def two_arms(objects: tuple[CellObject, ...] = (), gap: float = 0.88) -> Workcell:
    model = robot_model("gp4")
    table = np.array([0.4, 1.0, 0.02])
    return Workcell(
        (
            PlacedRobot("left", model, np.eye(4), model.home),
            PlacedRobot(
                "right", model, from_rpy([gap, 0.0, 0.0], [0, 0, np.pi]), model.home
            ),
        ),
        (
            Fixture(
                "table",
                box_shape("table", table),
                translation(gap / 2, 0.0, 0.17),
            ),
        ),
        objects,
    )


class Writer(PlanWriter):
    """Writes a sequential plan: one robot moves while the other one stands."""

    def __init__(self, cell: Workcell) -> None:
        super().__init__(cell, np.random.default_rng(0))

    @property
    def q(self) -> dict[str, Array]:
        return self.configurations

    def line_free(self, robot: str, goal: Array) -> bool:
        """Tell whether the straight line to a goal is free of the other arm and the table."""
        placed = {
            o.name: Attachment(None, translation(0.0, 0.0, -5.0 - k))
            for k, o in enumerate(self.cell.objects)
        }
        state = WorldState(self.q, {**self.cell.start_state().attachments, **placed})
        checker = SceneChecker(self.cell, robot, state, margin=0.002)
        return checker.motion_free(self.q[robot], goal)

    def move(
        self, robot: str, goal: Array, *handlings: Handling, step: float = STEP
    ) -> int:
        """Append a transit of nodes ``step`` apart; return its task."""
        start = self.q[robot]
        count = max(1, int(np.ceil(np.abs(goal - start).sum() / step)))
        path = start + np.linspace(0.0, 1.0, count + 1)[:, None] * (goal - start)
        pace = max(STEP, float(np.abs(goal - start).sum()) / count)
        time: Array = self.time + pace * np.arange(count + 1.0)
        index = len(self.tasks)
        given = tuple(
            replace(h, waypoint=count if h.waypoint < 0 else h.waypoint)
            for h in handlings
        )
        label = f"move {index}"
        self.tasks.append(Task(index, robot, "transit", 1, label, path[-1:], given))
        self.motions.append(TaskMotion(path, time))
        self.q[robot] = path[-1]
        self.time = float(time[-1])
        return index


def random_turns(seed: int, turns: int, gap: float = 0.88) -> MotionPlan:
    """Arms reach for the middle in turns and go home; some turns take two goals."""
    rng = np.random.default_rng(seed)
    writer = Writer(two_arms(gap=gap))
    for turn in range(turns):
        robot = writer.cell.robots[turn % 2]
        for _ in range(int(rng.integers(1, 3))):
            for _ in range(50):
                goal = robot.home + rng.uniform(-1, 1, 6) * [0.4, 0.6, 0.4, 0.5, 0.4, 1]
                goal[1] += 0.5
                if writer.line_free(robot.name, goal):
                    writer.move(robot.name, goal)
                    break
        if writer.line_free(robot.name, robot.home):
            writer.move(robot.name, robot.home)
    return writer.plan()
