"""Tasks of a space-time plan, and the fixed world that they make."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from planning.cell.workcell import Workcell
from planning.construction.world.fixed_world import FixedWorld
from planning.construction.world.timeline import SAME, ObjectTimeline, RobotTimeline
from planning.errors import PlanInvariantError
from planning.tasks.task_graph import TRANSIT, Handling
from planning.transforms import Array, readonly

Pairs = frozenset[frozenset[str]]


@dataclass(frozen=True)
class PlannedTask:
    """A task of one robot at its place in space-time.

    Attributes:
        robot: who does it.
        kind: ``"transit"`` or a name from ``planning.tasks.task_graph.SKILLS``.
        time: of the waypoints, rising, shape (w,) [s].
        path: waypoints, the first where the robot is when the task starts, shape (w, n).
        step: assembly step it serves, counted from 1.
        label: short text for people.
        object: object it is about, None for a plain move.
        handlings: what changes hands in it; ``waypoint`` is a row of ``path``.
        touching: unordered pairs of entities that may touch meanwhile.
        way_out: True for a way out of others' way, which new work may replace.
    """

    robot: str
    kind: str
    time: Array
    path: Array
    step: int
    label: str
    object: str | None = None
    handlings: tuple[Handling, ...] = ()
    touching: Pairs = field(default_factory=frozenset)
    way_out: bool = False

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        object.__setattr__(self, "time", readonly(self.time))
        object.__setattr__(self, "path", readonly(np.atleast_2d(self.path)))

    @property
    def start(self) -> float:
        """When it starts [s]."""
        return float(self.time[0])

    @property
    def end(self) -> float:
        """When it ends [s]."""
        return float(self.time[-1])


def with_task(world: FixedWorld, task: PlannedTask) -> FixedWorld:
    """Return the world after one more task: the robot's motion and what changes hands.

    Args:
        world: in which the robot has no later task.
        task: begins where the robot stands, no earlier than its timeline ends.

    Raises:
        PlanInvariantError: it does not begin there, or an object changes hands out of order.
    """
    line = world.robots[task.robot].then(
        task.time,
        task.path,
        skill=task.kind != TRANSIT,
        work=not task.way_out,
    )
    world = world.with_robot(line)
    for handling in task.handlings:
        at = float(task.time[handling.waypoint])
        item = world.objects[handling.object].then(at, handling.holder, handling.pose)
        world = world.with_object(item)
    return world


def world_of(cell: Workcell, tasks: Sequence[PlannedTask]) -> FixedWorld:
    """Return the world in which robots do tasks, starting at HOME.

    Args:
        cell: the static cell.
        tasks: in any order; those of one robot follow each other in time.
    """
    world = FixedWorld(
        cell,
        {r.name: RobotTimeline(r.name, np.zeros(1), r.home[None]) for r in cell.robots},
    )
    for task in sorted(tasks, key=lambda t: (t.start, t.end)):
        world = with_task(world, replace(task, handlings=()))
    events = [
        (float(task.time[h.waypoint]), k, h)
        for k, task in enumerate(tasks)
        for h in task.handlings
    ]
    for at, _, h in sorted(events, key=lambda e: (e[0], e[1])):
        line: ObjectTimeline = world.objects[h.object]
        world = world.with_object(line.then(at, h.holder, h.pose))
    return world


def drop_way_out(
    tasks: Sequence[PlannedTask], robot: str, t: float | None = None
) -> tuple[PlannedTask, ...]:
    """Return the tasks without a robot's way out of others' way after time ``t``.

    What ``drop_tail`` does for a world.

    Args:
        tasks: of all robots.
        robot: who gets new work.
        t: no earlier than the end of its work, which is meant where not given [s].

    Raises:
        PlanInvariantError: ``t`` is before the end of the robot's work.
    """
    busy = max(
        (k.end for k in tasks if k.robot == robot and not k.way_out), default=0.0
    )
    cut = busy if t is None else t
    if cut < busy - SAME:
        raise PlanInvariantError(
            f"robot {robot!r} is busy until {busy:.3f} s: its way out cannot end at"
            f" {cut:.3f} s"
        )
    kept = []
    for task in tasks:
        if task.robot != robot or not task.way_out or task.end <= cut + SAME:
            kept.append(task)
        elif task.start < cut - SAME:
            line = RobotTimeline(robot, task.time, task.path)
            n = int(np.searchsorted(task.time, cut, side="left"))
            kept.append(
                replace(
                    task,
                    time=np.append(task.time[:n], cut),
                    path=np.vstack([task.path[:n], line.at(cut)[None]]),
                )
            )
    return tuple(kept)
