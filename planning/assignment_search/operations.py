"""Operations of an assembly step: skills, and straight motions to the start of a robot's next skill."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, replace

import numpy as np

from planning.cell.workcell import Workcell
from planning.motion.full_turns import without_turns
from planning.motion.sequential import MotionSettings
from planning.motion.speed import path_times
from planning.tasks.task import StepTasks, Task, TaskKind, cell_with_steps
from planning.transforms import Array

TRAVEL = "travel"
"""Kind of an operation: a straight motion to the start of the robot's next operation."""


@dataclass(frozen=True)
class RobotOperation:
    """A skill of a robot within a step, or a straight motion to the start of its next one.

    Attributes:
        robot: its name.
        kind: that of the task, or TRAVEL.
        path: joint waypoints with the start, shape (w, n).
        times: times of passing the waypoints, from 0, shape (w,) [s].
        after: numbers of the operations of the step that must be complete before it starts.
        leads: whether it is a travel to the robot's next skill.
    """

    robot: str
    kind: str
    path: Array
    times: Array
    after: tuple[int, ...] = ()
    leads: bool = False

    @property
    def seconds(self) -> float:
        """Duration [s]."""
        return float(self.times[-1])


def list_operations(
    cell: Workcell, step: StepTasks, settings: MotionSettings
) -> list[RobotOperation]:
    """Return the operations of a step in sequential order.

    Transits on which no other task depends are replaced by straight motions between two skills. The motion to the
    robot's first skill is not included, because it depends on the step before.
    """
    here = cell_with_steps(cell, [step])
    awaited = {task for pair in step.dependencies for task in pair}
    before: dict[int, list[int]] = defaultdict(list)
    for first, then in step.dependencies:
        before[then].append(first)
    found: list[RobotOperation] = []
    done: dict[int, int] = {}
    last: dict[str, int] = {}
    lead: dict[str, Array] = {}
    pending: dict[str, list[int]] = defaultdict(list)
    for task in step.tasks:
        robot = task.robot
        own = [done[a] for a in before[task.index] if a in done]
        moves = task.kind == TaskKind.TRANSIT
        if moves:
            pending[robot] += own
        if moves and (task.index not in awaited or robot not in last):
            lead[robot] = task.path[-1]
            if task.index in awaited:
                found.append(_standing(task, pending.pop(robot, [])))
                done[task.index] = last[robot] = len(found) - 1
            continue
        start = lead.pop(robot, None)
        if robot in last:
            ended = found[last[robot]].path[-1]
            to = task.path[-1] if moves else ended if start is None else start
            if not np.array_equal(ended, to):
                waits = tuple(pending.pop(robot, []))
                travel = _travel(cell, robot, ended, to, settings)
                found.append(replace(travel, after=waits, leads=not moves))
                last[robot] = len(found) - 1
            start = to
        if not moves:
            if start is None:
                start = cell.robot(robot).home
            own += pending.pop(robot, [])
            found.append(_skill(here, task, start, settings, own))
            last[robot] = len(found) - 1
        done[task.index] = last[robot]
    return found


def _standing(task: Task, after: list[int]) -> RobotOperation:
    at = np.repeat(task.path[-1:], 2, axis=0)
    return RobotOperation(task.robot, TRAVEL, at, np.zeros(2), tuple(after))


def _travel(
    cell: Workcell, robot: str, start: Array, end: Array, settings: MotionSettings
) -> RobotOperation:
    """Return the straight motion to a configuration, whole turns left out."""
    turning = ~cell.robot(robot).model.chain.prismatic
    path = np.vstack([start, start + without_turns(end - start, turning)])
    times = np.array([0.0, settings.speeds[robot].duration(path[0], path[1])])
    return RobotOperation(robot, TRAVEL, path, times)


def _skill(
    cell: Workcell, task: Task, start: Array, settings: MotionSettings, after: list[int]
) -> RobotOperation:
    path = np.vstack([start, task.path])
    seconds = settings.seconds_of(cell, task)
    if seconds is None:
        seconds = settings.seconds_along(task, path)
    times = path_times(path, settings.speeds[task.robot])
    if times[-1] > 0.0:
        times = times * (seconds / times[-1])
    else:
        times = np.linspace(0.0, seconds, len(path))
    return RobotOperation(task.robot, task.kind, path, times, tuple(after))
