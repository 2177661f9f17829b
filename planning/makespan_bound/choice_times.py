"""Least times of the choices of steps, as matrices over the max-plus algebra.

The clocks before a step are the completion time of the previous step, and the times at which the robots reach their
first configurations. Each task starts at the maximum of some times, and has a known least duration. Therefore the
clocks after the step are maxima of the clocks before it plus constants.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from planning.cell.workcell import Workcell
from planning.motion.full_turns import without_turns
from planning.motion.sequential import MotionSettings
from planning.motion.speed import LimitedSpeed, SpeedModel
from planning.tasks.assembly import Assembly
from planning.tasks.assignment import StepChoice, TaskPlan
from planning.tasks.task import StepTasks, Task, TaskKind, cell_with_steps
from planning.transforms import Array

LeastSeconds = Callable[[int, Array], Array]
"""Least times of motions of a robot [s]: of its number, and differences of configurations, shape (..., n)."""

NEVER = -np.inf
"""Entry of a matrix where a clock does not depend on another one."""

_CHANGES = (TaskKind.LEAVE_TOOL, TaskKind.TAKE_TOOL)
"""Kinds of tasks that depend on the choices of other steps."""


@dataclass(frozen=True)
class ChoiceTimes:
    """Least times of a choice of a step.

    Attributes:
        choice: robots, object, grasp and support.
        matrix: clocks after the step from those before it, shape (1 + r, 1 + r) [s]. The first clock is the
            completion of the task that the next step waits for, NEVER for none; the others are those of the r
            robots and machines.
        start, end: first and last configuration of the robots that take part, by number of the robot, shape (n,).
    """

    choice: StepChoice
    matrix: Array
    start: dict[int, Array]
    end: dict[int, Array]


def least_seconds(speed: SpeedModel, turning: np.ndarray, apart: Array) -> Array:
    """Return the least times of motions between configurations, whatever the path, shape (...) [s].

    The speed models of durations alone are norms, of which the straight path is the shortest. With limits of
    acceleration no joint is faster than from rest to rest at its own limits.

    Args:
        speed: of the robot.
        turning: whether each joint turns, shape (n,): whole turns of it are left out.
        apart: differences of the configurations, shape (..., n) [rad or m].
    """
    travel = np.abs(without_turns(apart, turning))
    if not isinstance(speed, LimitedSpeed):
        return speed.durations(travel)
    limits = speed.limits
    most, gains = limits.velocity, limits.acceleration
    ramps = most / gains
    short = travel < most * ramps
    seconds = np.where(short, 2.0 * np.sqrt(travel / gains), travel / most + ramps)
    least = travel.sum(axis=-1) / limits.sum_of_speeds
    return np.asarray(np.maximum(seconds.max(axis=-1), least))


class ChoiceReader:
    """Computes the least times of choices from their tasks, given any plan of what is built."""

    def __init__(
        self, cell: Workcell, work: Assembly, plan: TaskPlan, settings: MotionSettings
    ) -> None:
        self._cell, self._work, self._plan = cell, work, plan
        self._settings = settings
        everyone = (*cell.robots, *cell.machines)
        self._number = {robot.name: k for k, robot in enumerate(everyone)}
        self._planned = [self._expand(choice) for choice in plan.choices]
        # By step: the kind of task that the next step waits for in the plan.
        self._awaited: dict[int, str] = {}
        for before, then in pairwise(self._planned):
            for task, _ in self._waits([before, then]):
                self._awaited[task.step] = task.kind

    @property
    def ends_elsewhere(self) -> frozenset[int]:
        """Numbers of the robots whose last task in the plan does not end at HOME."""
        last = {task.robot: task for step in self._planned for task in step.tasks}
        return frozenset(
            k
            for k, robot in enumerate(self._cell.robots)
            if robot.name in last
            and not np.array_equal(last[robot.name].path[-1], robot.home)
        )

    def read(self, choice: StepChoice) -> ChoiceTimes:
        """Return the least times of a choice."""
        k = choice.step
        tasks, near = self._expand(choice), self._planned
        waits = self._waits([*near[max(k - 2, 0) : k - 1], tasks, *near[k : k + 1]])
        awaited = self._awaited
        last = {a.step: a.index for a, _ in waits if a.kind == awaited.get(a.step)}
        gated = {b.index for a, b in waits if a.step < k and a.index == last.get(k - 1)}
        return self._times(choice, tasks, last.get(k, -1), gated)

    def _waits(self, steps: Sequence[StepTasks]) -> list[tuple[Task, Task]]:
        """Return what waits for the step before, in the order of the awaited tasks."""
        found = [
            (a, b)
            for a, b in self._work.waits(steps)
            if a.step + 1 == b.step and a.kind not in TaskKind.SUPPLY
        ]
        return sorted(found, key=lambda pair: pair[0].index)

    def _expand(self, choice: StepChoice) -> StepTasks:
        plan = self._plan.with_choice(choice)
        # What precedes all steps is among the tasks from number 0 on.
        return self._work.expand(plan, choice.step, 1)

    def _times(
        self, choice: StepChoice, step: StepTasks, key: int, gated: set[int]
    ) -> ChoiceTimes:
        here = cell_with_steps(self._cell, [step])
        size = 1 + len(self._number)
        clocks = np.where(np.eye(size, dtype=np.bool_), 0.0, NEVER)
        came, complete = clocks[0].copy(), np.full(size, NEVER)
        before: dict[int, list[int]] = defaultdict(list)
        for first, then in step.dependencies:
            before[then].append(first)
        awaited = {first for first, _ in step.dependencies} | {key}
        done: dict[int, Array] = {}
        start: dict[int, Array] = {}
        end: dict[int, Array] = {}
        lead: dict[int, Array] = {}

        def go(k: int, to: Array) -> None:
            if k in end:
                robot = self._cell.robots[k]
                speed = self._settings.speeds[robot.name]
                turning = ~robot.model.chain.prismatic
                clocks[1 + k] += least_seconds(speed, turning, to - end[k])
            start.setdefault(k, to)
            end[k] = to

        for task in step.tasks:
            machine = self._cell.is_machine(task.robot)
            k = self._number[task.robot]
            if task.kind in (*_CHANGES, *TaskKind.SUPPLY):
                continue
            if not machine and task.robot not in choice.robots:
                continue  # it releases an object that it has held since an earlier step
            own = [done[a] for a in before[task.index] if a in done]
            if task.index in gated:
                own.append(came)
            if task.kind != TaskKind.TRANSIT and not machine:
                origin = lead.pop(k, end.get(k))
                if origin is not None:
                    go(k, origin)
            clocks[1 + k] = np.max([clocks[1 + k], *own], axis=0)
            if task.kind == TaskKind.TRANSIT:
                lead[k] = task.path[-1]
                if task.goal or task.index in awaited:
                    go(k, lead.pop(k))
            elif machine:
                clocks[1 + k] += self._settings.seconds_of(here, task) or 0.0
            else:
                clocks[1 + k] += self._skill_seconds(here, task, origin)
                start.setdefault(k, task.path[0])
                end[k] = task.path[-1]
            done[task.index] = clocks[1 + k].copy()
            if task.index == key:
                complete = done[key]
        clocks[0] = complete
        return ChoiceTimes(choice, clocks, start, end)

    def _skill_seconds(self, cell: Workcell, task: Task, origin: Array | None) -> float:
        """Return the least duration of a skill from a configuration, None for any [s]."""
        seconds = self._settings.seconds_of(cell, task)
        if seconds is not None:
            # From anywhere, some of it may be the motion to the first waypoint, which counts by itself.
            return seconds if origin is not None else 0.0
        path = task.path if origin is None else np.vstack([origin, task.path])
        return self._settings.seconds_along(task, path)
