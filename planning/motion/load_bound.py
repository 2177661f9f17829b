"""Lower bound of the makespan: the workload of the busiest robot, minimized over all assignments.

The workload of a robot consists of its skills and of the straight joint-space distances between them within each
step. Motions between steps, waits and detours are not counted. Joint values that differ by full turns count as equal.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pulp

from planning.cell.workcell import Workcell
from planning.motion.full_turns import without_turns
from planning.motion.sequential import MotionSettings
from planning.silence import QuietHighs
from planning.tasks.assembly import Assembly
from planning.tasks.assignment import TaskPlan, step_choices
from planning.tasks.task import StepTasks, Task, TaskKind, cell_with_steps

_MOST_WAYS = 2000
"""Greatest number of alternatives of an assembly for which a bound is computed."""


@dataclass(frozen=True)
class AlternativeLoad:
    """Least busy time of the robots for one alternative of a step.

    Attributes:
        step: counted from 1.
        object: what is placed.
        seconds: of each robot that takes part [s].
    """

    step: int
    object: str
    seconds: dict[str, float]


def load_bound_s(
    cell: Workcell, work: Assembly, plan: TaskPlan, settings: MotionSettings
) -> float | None:
    """Return a lower bound of the makespan over robots, objects, grips and supports [s].

    The steps stay as they are. It is the optimum of a linear program, whatever the robots share.

    Args:
        cell: where it is built.
        work: what is built.
        plan: any plan of it.
        settings: how tasks are turned into motions.

    Returns:
        The bound, None where there are too many alternatives.
    """
    choices = list(step_choices(work.problem))
    if len(choices) > _MOST_WAYS:
        return None
    loads = []
    for choice in choices:
        tasks = work.expand(plan.with_choice(choice), choice.step, 0)
        # Other robots may release what they held.
        own = [task for task in tasks.tasks if task.robot in choice.robots]
        seconds = _busy_seconds(cell, replace(tasks, tasks=tuple(own)), settings)
        loads.append(AlternativeLoad(choice.step, choice.object, seconds))
    return least_load(loads, work.problem.unlimited)


def _busy_seconds(
    cell: Workcell, step: StepTasks, settings: MotionSettings
) -> dict[str, float]:
    """Return the least busy time of each robot, and of each working machine, in a step [s].

    Args:
        cell: without what comes up in the step.
        step: its tasks.
        settings: how they are turned into motions.
    """
    here = cell_with_steps(cell, [step])
    own: dict[str, list[Task]] = defaultdict(list)
    found: dict[str, float] = defaultdict(float)
    for task in step.tasks:
        if not cell.is_machine(task.robot):
            own[task.robot].append(task)
        elif task.kind not in TaskKind.SUPPLY:
            found[task.robot] += settings.seconds_of(here, task) or 0.0
    for robot, tasks in own.items():
        speed = settings.speeds[robot]
        turning = ~cell.robot(robot).model.chain.prismatic
        total, ended, at = 0.0, None, None
        for task in tasks:
            if task.kind == TaskKind.TRANSIT and not task.goal:
                at = task.path[-1]
                continue
            start = at if at is not None else ended
            if start is not None and ended is not None:
                apart = without_turns(start - ended, turning)
                total += speed.duration(np.zeros_like(apart), apart)
            seconds = settings.seconds_of(here, _of_known(here, task))
            path = task.path if start is None else np.vstack([start, task.path])
            if seconds is None:
                seconds = speed.times_along(path)[-1] + sum(
                    settings.still_seconds(task)
                )
            total += seconds
            ended, at = task.path[-1], None
        found[robot] = total
    return found


def _of_known(cell: Workcell, task: Task) -> Task:
    """Return a task with a present object of the same type in place of a station's copy."""
    names = {item.name for item in cell.objects}
    name = task.object
    while name and name not in names:
        name = name.rpartition(".")[0]
    return task if name == task.object else replace(task, object=name or None)


def least_load(alternatives: list[AlternativeLoad], unlimited: frozenset[str]) -> float:
    """Return the least load of the busiest robot when steps and objects are shared out freely [s].

    Args:
        alternatives: alternatives of the steps.
        unlimited: objects that may be used more than once.
    """
    model = pulp.LpProblem("load", pulp.LpMinimize)
    longest = model.add_variable("longest", 0)
    model += longest
    of_step: dict[int, list[Any]] = defaultdict(list)
    of_object: dict[str, list[Any]] = defaultdict(list)
    of_robot: dict[str, list[tuple[Any, float]]] = defaultdict(list)
    for number, alternative in enumerate(alternatives):
        share = model.add_variable(f"w{number}", 0, 1)
        of_step[alternative.step].append(share)
        if alternative.object not in unlimited:
            of_object[alternative.object].append(share)
        for robot, seconds in alternative.seconds.items():
            of_robot[robot].append((share, seconds))
    for shares in of_step.values():
        model += pulp.lpSum(shares) == 1
    for shares in of_object.values():
        model += pulp.lpSum(shares) <= 1
    for terms in of_robot.values():
        model += pulp.LpAffineExpression(terms) <= longest
    model.solve(QuietHighs())
    return float(longest.value())
