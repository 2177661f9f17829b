"""Preparation of robot goals: motions without handling (APEX-MR, Appendix D, c)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from planning.cell.workcell import Workcell, start_state
from planning.geometry.scene_checker import SceneChecker
from planning.kinematics.kinematics import inverse_kinematics
from planning.motion.sequential import MARGIN
from planning.steps.step_writer import StepWriter
from planning.tasks.assignment import (
    AssignmentProblem,
    PrimaryCandidate,
    Rejection,
    TaskPlan,
)
from planning.tasks.task import StepTasks
from planning.tasks.work import AssemblyWork
from planning.transforms import Array, Transform

_MOST = 12
"""Configurations tried for one pose of a tool."""


@dataclass(frozen=True)
class RobotGoal:
    """Goal of a robot: a configuration, or a pose of one of its frames.

    Attributes:
        robot: who goes.
        joints: configuration, shape (n,), or None.
        pose: of the frame in the world, or None.
        frame: tool frame that goes to the pose.
    """

    robot: str
    joints: Array | None = None
    pose: Transform | None = None
    frame: str = "tool"


def prepare_goals(cell: Workcell, goals: Sequence[RobotGoal]) -> AssemblyWork:
    """Find the configurations in which each goal is reached; one step a goal, in this order.

    A configuration must be clear of the fixtures, the resting objects and the robot itself.
    Whether other robots are in the way depends on where they are by then.

    Args:
        cell: the static cell.
        goals: in the order in which a sequential plan goes there.
    """
    primaries: list[PrimaryCandidate] = []
    rejections: list[Rejection] = []
    found: dict[tuple[int, int], Array] = {}
    at = {robot.name: robot.home for robot in cell.robots}
    for step, goal in enumerate(goals, start=1):
        alone = replace(cell, robots=(cell.robot(goal.robot),))
        checker = SceneChecker(alone, goal.robot, start_state(alone), margin=MARGIN)
        ways = _configurations(cell, goal, at[goal.robot])
        if not ways:
            rejections.append(Rejection(step, goal.robot, "the pose is out of reach"))
        for number, q in enumerate(ways):
            contact = checker.contact(q)
            if contact is not None:
                what = f"{goal.robot}, configuration {number + 1}"
                rejections.append(Rejection(step, what, str(contact)))
                continue
            cost = float(np.sum(np.abs(q - at[goal.robot])))
            found[step, number] = q
            primaries.append(
                PrimaryCandidate(step, goal.robot, _nothing(step), number, cost)
            )
        reached = [found[key] for key in found if key[0] == step]
        if reached:
            at[goal.robot] = reached[0]
    problem = AssignmentProblem(
        robots=tuple(robot.name for robot in cell.robots),
        steps=tuple(
            f"{goal.robot} goes to goal {k + 1}" for k, goal in enumerate(goals)
        ),
        needs_support=(False,) * len(goals),
        primaries=tuple(primaries),
        balance=0.0,
        rejections=tuple(rejections),
    )

    def expand(plan: TaskPlan, step: int, first_index: int) -> StepTasks:
        choice = plan[step]
        build = StepWriter(cell, step, first_index)
        goal = found[step, choice.grasp]
        build.transit(choice.robot, goal, f"to goal {step}", None, goal=True)
        return build.build()

    return AssemblyWork(problem, expand)


def _nothing(step: int) -> str:
    """Return the name of the object that a step is about: there is none, so one of its own."""
    return f"goal {step}"


def _configurations(cell: Workcell, goal: RobotGoal, near: Array) -> list[Array]:
    if goal.joints is not None:
        return [goal.joints]
    assert goal.pose is not None
    robot = cell.robot(goal.robot)
    return inverse_kinematics(robot, goal.frame, goal.pose, near)[:_MOST]
