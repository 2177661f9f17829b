"""Robot goals as assembly steps: motions without handling of objects (APEX-MR App. D, c)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from planning.cell.workcell import Workcell
from planning.geometry.scene_checker import SceneChecker
from planning.kinematics.kinematics import inverse_kinematics
from planning.motion.sequential import MARGIN
from planning.steps.candidate_collector import CandidateCollector
from planning.steps.skill import Obstruction, joint_distance
from planning.steps.step_writer import StepWriter
from planning.tasks.assembly import Assembly
from planning.tasks.assignment import PrimaryCandidate, TaskPlan
from planning.tasks.task import StepTasks
from planning.transforms import Array, Transform

_MOST_CONFIGURATIONS = 12
"""Configurations tried for one pose of a tool."""


@dataclass(frozen=True)
class RobotGoal:
    """Goal of a robot: a configuration, or a pose of one of its frames.

    Attributes:
        robot: the robot.
        joints: configuration, shape (n,), or None.
        pose: of the frame in the world, or None.
        frame: tool frame that goes to the pose.
    """

    robot: str
    joints: Array | None = None
    pose: Transform | None = None
    frame: str = "tool"


@dataclass(frozen=True)
class GoalWork(Assembly):
    """Robot goals with their configurations, for assignment and motion planning; nothing is built.

    Attributes:
        cell: the static cell.
        goals: in the order of the steps.
        configurations: by step and number of the candidate.
    """

    cell: Workcell
    goals: tuple[RobotGoal, ...]
    configurations: Mapping[tuple[int, int], Array] = field(repr=False)

    @property
    def built(self) -> tuple[RobotGoal, ...]:
        """The goals."""
        return self.goals

    @property
    def steps(self) -> int:
        """Number of goals."""
        return len(self.goals)

    def expand(self, plan: TaskPlan, step: int, first: int) -> StepTasks:
        """Return the transit to a goal."""
        choice = plan[step]
        build = StepWriter(self.cell, step, first)
        goal = self.configurations[step, choice.grasp]
        build.transit(choice.robot, goal, f"to goal {step}", goal=True)
        return build.build()


def prepare_goals(cell: Workcell, goals: Sequence[RobotGoal]) -> GoalWork:
    """Find goal configurations; one step per goal, in this order.

    A configuration must be clear of the fixtures, the resting objects and the robot itself.
    Other robots are ignored: their configurations are not known yet.

    Args:
        cell: the static cell.
        goals: in the order in which a sequential plan goes there.
    """
    collector = CandidateCollector(cell.robots)
    found: dict[tuple[int, int], Array] = {}
    at = dict(collector.home)
    for step, goal in enumerate(goals, start=1):
        name = goal.robot
        alone = replace(cell, robots=(cell.robot(name),))
        checker = SceneChecker(alone, name, alone.start_state(), margin=MARGIN)
        configurations = _configurations(cell, goal, at[name])
        if not configurations:
            collector.reject(step, name, "the pose is out of reach", name)
        for number, q in enumerate(configurations):
            if (contact := checker.contact(q)) is not None:
                what = f"{name}, configuration {number + 1}"
                hit = Obstruction(str(contact), contact.obstacle)
                collector.reject(step, what, hit, name)
                continue
            found[step, number] = q
            cost = joint_distance(q, at[name])
            # A goal is about no object: each has one of its own.
            candidate = PrimaryCandidate(step, name, f"goal {step}", number, cost)
            collector.primaries.append(candidate)
        reached = [found[key] for key in found if key[0] == step]
        if reached:
            at[name] = reached[0]
    steps = [f"{goal.robot} goes to goal {k}" for k, goal in enumerate(goals, start=1)]
    problem = collector.problem(steps, [False] * len(goals), balance=0.0)

    return GoalWork(problem, cell, tuple(goals), found)


def _configurations(cell: Workcell, goal: RobotGoal, near: Array) -> list[Array]:
    if goal.joints is not None:
        return [goal.joints]
    assert goal.pose is not None
    robot = cell.robot(goal.robot)
    return inverse_kinematics(robot, goal.frame, goal.pose, near)[:_MOST_CONFIGURATIONS]
