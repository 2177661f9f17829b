"""Robot goals as assembly steps: motions without handling of objects (APEX-MR App. D, c)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from planning.cell.workcell import Workcell
from planning.goals.goal_order import order_goals
from planning.goals.robot_goal import RobotGoal
from planning.steps.candidate_collector import CandidateCollector
from planning.steps.skill import joint_distance
from planning.steps.step_writer import StepWriter
from planning.tasks.assembly import Assembly
from planning.tasks.assignment import PrimaryCandidate, TaskPlan
from planning.tasks.task import StepTasks
from planning.transforms import Array


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
        """Return the transit to a goal; one that makes room may be shortened."""
        choice = plan[step]
        build = StepWriter(self.cell, step, first)
        goal = self.configurations[step, choice.grasp]
        own = self.goals[step - 1]
        needed = own.purpose == "goal"
        build.transit(choice.robot, goal, own.label, goal=needed)
        return build.build()


def prepare_goals(cell: Workcell, goals: Sequence[RobotGoal]) -> GoalWork:
    """Find goal configurations; one step per goal, in an order in which no robot stands at the goal of another.

    A configuration must be clear of the fixtures, the resting objects and the robot itself.

    Args:
        cell: the static cell.
        goals: in the order in which a sequential plan goes there if no robot is in the way.
    """
    collector = CandidateCollector(cell.robots)
    found: dict[tuple[int, int], Array] = {}
    reached = order_goals(cell, goals)
    for step, there in enumerate(reached, start=1):
        name = there.goal.robot
        for number, reason in there.rejected.items():
            what = f"{name}, configuration {number + 1}"
            collector.reject(step, what, reason, name)
        for number, q in there.configurations.items():
            found[step, number] = q
            cost = joint_distance(q, there.start)
            # A goal is about no object: each has one of its own.
            candidate = PrimaryCandidate(step, name, f"goal {step}", number, cost)
            collector.primaries.append(candidate)
    steps = [f"{there.goal.robot} goes {there.goal.label}" for there in reached]
    problem = collector.problem(steps, [False] * len(steps), balance=0.0)
    return GoalWork(problem, cell, tuple(there.goal for there in reached), found)
