"""Choice between joint values that differ by full turns, for joints whose range exceeds one turn.

For example, a wrist reaches the same pose at -170 and at +190 degrees. One of these values is slightly nearer to
HOME. But the robot may continue to its next pose without returning to HOME; the wrong value then costs a full turn.
Therefore each excursion from HOME to HOME is shifted by full turns: of the shifts that add little travel from HOME,
the one is chosen whose first configuration is nearest to the last configuration of the previous excursion.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from planning.cell.workcell import Workcell
from planning.tasks.task import StepTasks, Task, TaskKind
from planning.transforms import Array

_SAME = 1e-9
"""Configurations as near as this are the same [rad or m]."""

_HARDLY = 0.7
"""Extra travel from HOME that turning towards the next work is worth [rad]."""


def take_near_turns(
    cell: Workcell, step: StepTasks, reached: Mapping[str, Array]
) -> tuple[StepTasks, dict[str, Array]]:
    """Return a step shifted by the full turns nearest to each robot's previous configuration.

    Args:
        cell: the static cell.
        step: an expanded step.
        reached: per robot, the configuration in which its last excursion ended, shape (n,).

    Returns:
        The step, and ``reached`` after it.
    """
    reached = dict(reached)
    tasks = {task.index: task for task in step.tasks}
    for robot in cell.robots:
        excursion: list[Task] = []
        for task in [t for t in step.tasks if t.robot == robot.name]:
            transit = task.kind == TaskKind.TRANSIT
            if not transit or np.max(np.abs(task.path[-1] - robot.home)) >= _SAME:
                excursion.append(task)
                continue
            _turn(cell, robot.name, excursion, tasks, reached)
            excursion = []
        _turn(cell, robot.name, excursion, tasks, reached)
    return replace(step, tasks=tuple(tasks[t.index] for t in step.tasks)), reached


def without_turns(apart: Array, turning: np.ndarray) -> Array:
    """Return the least differences of joint values modulo whole turns, shape (..., n).

    Args:
        apart: differences, shape (..., n) [rad or m].
        turning: whether each joint turns, shape (n,); others keep their difference.
    """
    least = (apart + np.pi) % (2 * np.pi) - np.pi
    return np.where(turning, least, apart)


def _turn(
    cell: Workcell,
    robot: str,
    excursion: list[Task],
    tasks: dict[int, Task],
    reached: dict[str, Array],
) -> None:
    """Shift all configurations of an excursion by the same whole turns."""
    if not excursion:
        return
    model = cell.robot(robot).model
    waypoints = np.concatenate([task.path for task in excursion])
    shift = np.zeros(model.dof)
    if robot in reached:
        for joint in np.flatnonzero(~model.chain.prismatic):
            shift[joint] = (
                2
                * np.pi
                * _turns(
                    waypoints[:, joint],
                    float(reached[robot][joint]),
                    float(cell.robot(robot).home[joint]),
                    float(model.lower[joint]),
                    float(model.upper[joint]),
                )
            )
    for task in excursion:
        tasks[task.index] = replace(task, path=task.path + shift)
    reached[robot] = excursion[-1].path[-1] + shift


def _turns(values: Array, near: float, home: float, lower: float, upper: float) -> int:
    """Return the turns within the limits that bring the first value nearest to ``near``."""
    least = int(np.ceil((lower - values.min()) / (2 * np.pi) - 1e-12))
    most = int(np.floor((upper - values.max()) / (2 * np.pi) + 1e-12))
    turns = range(least, most + 1)
    reach = [abs(values[0] + 2 * np.pi * k - home) for k in turns]
    good = [
        k for k, far in zip(turns, reach, strict=True) if far <= min(reach) + _HARDLY
    ]
    return min(
        good, key=lambda k: (abs(values[0] + 2 * np.pi * k - near), abs(k)), default=0
    )
