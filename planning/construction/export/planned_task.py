"""Tasks of a space-time plan, and the fixed world that they make."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from planning.cell.workcell import Workcell
from planning.construction.world.fixed_world import FixedWorld
from planning.tasks.task import TRANSIT, Handling
from planning.transforms import Array, readonly

Pairs = frozenset[frozenset[str]]


@dataclass(frozen=True)
class PlannedTask:
    """A task of one robot at its place in space-time.

    Attributes:
        robot: who does it.
        kind: ``"transit"`` or a name from ``planning.tasks.task.SKILLS``.
        time: of the waypoints, rising, shape (w,) [s].
        path: waypoints, the first where the robot is when the task starts, shape (w, n).
        step: assembly step it serves, counted from 1.
        label: short text for people.
        object: object it is about, None for a plain move.
        handlings: what changes hands in it; ``waypoint`` is a row of ``path``.
        touching: unordered pairs of entities that may touch meanwhile.
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

    def __post_init__(self) -> None:
        """Freeze the arrays."""
        object.__setattr__(self, "time", readonly(self.time))
        object.__setattr__(self, "path", readonly(np.atleast_2d(self.path)))

    @property
    def start(self) -> float:
        """Planned start [s]."""
        return float(self.time[0])

    @property
    def end(self) -> float:
        """Planned end [s]."""
        return float(self.time[-1])


def world_of(cell: Workcell, tasks: Sequence[PlannedTask]) -> FixedWorld:
    """Return the world in which robots do tasks, starting at HOME.

    Args:
        cell: the static cell.
        tasks: in any order; those of one robot follow each other in time.

    Raises:
        PlanInvariantError: a task does not begin where and when its robot stands, or an object
            changes hands out of order.
    """
    world = FixedWorld(cell)
    for task in sorted(tasks, key=lambda t: (t.start, t.end)):
        skill = task.kind != TRANSIT
        line = world.robots[task.robot].then(task.time, task.path, skill=skill)
        world = world.with_robot(line)
    events = [
        (float(task.time[h.waypoint]), k, h)
        for k, task in enumerate(tasks)
        for h in task.handlings
    ]
    for at, _, h in sorted(events, key=lambda e: (e[0], e[1])):
        world = world.with_object(world.objects[h.object].then(at, h.holder, h.pose))
    return world
