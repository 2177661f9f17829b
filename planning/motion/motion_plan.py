"""Motion plans as data: one timed path per task."""

from __future__ import annotations

from dataclasses import dataclass

from planning.cell.workcell import Workcell
from planning.tasks.task import AllowedContact, Task, TimeWindow
from planning.transforms import Array, Indices


@dataclass(frozen=True)
class TaskMotion:
    """The path of one task.

    Attributes:
        path: waypoints, shape (w, n), the first being the configuration the task starts from.
            Consecutive waypoints are joined by straight lines in joint space.
        time: planned time of each waypoint, shape (w,), from the start of the plan [s].
    """

    path: Array
    time: Array


@dataclass(frozen=True)
class MotionPlan:
    """Paths of all tasks, with the planned times that fix the precedence between robots.

    Attributes:
        cell: the static cell.
        tasks: in order of their index.
        motions: one per task, same order. A skill's ``path[k]`` is waypoint k of its handlings.
        dependencies: pairs (a, b), shape (e, 2): task a must be complete before b starts.
        allowed: allowed contacts, with their times.
        windows: of time between tasks.
    """

    cell: Workcell
    tasks: tuple[Task, ...]
    motions: tuple[TaskMotion, ...]
    dependencies: Indices
    allowed: tuple[AllowedContact, ...]
    windows: tuple[TimeWindow, ...] = ()
