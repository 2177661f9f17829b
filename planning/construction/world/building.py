"""States of the search: fixed timelines, and the tasks that have been planned."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from planning.construction.problem.problem import ConstructionProblem
from planning.construction.world.fixed_world import FixedWorld
from planning.construction.world.skill_motion import SkillMotion
from planning.construction.world.timeline import ObjectTimeline
from planning.steps.skill import NOTHING, Pairs
from planning.tasks.task import Handling
from planning.transforms import Array, Transform, readonly

_WORDS = {"pick": "pick", "place-down": "place", "handover": "hand over"}


@dataclass(frozen=True)
class PlannedTask:
    """A task of one robot at its place in space-time.

    Attributes:
        robot: who does it.
        kind: ``"transit"`` or the name of a skill.
        time: of the waypoints, rising, shape (w,) [s].
        path: waypoints, the first where the robot is when the task starts, shape (w, n).
        step: number of the part that it serves in the order of planning, from 1.
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
    touching: Pairs = NOTHING

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

    @property
    def touch(self) -> float:
        """When the object of a skill changes hands [s]."""
        return float(self.time[self.handlings[0].waypoint])

    @property
    def holder(self) -> str | None:
        """Who holds the object of a skill from then on, None when it is put down."""
        return self.handlings[0].holder


@dataclass(frozen=True)
class Building:
    """A state of the search. Never changed: planning on makes a new one.

    Attributes:
        world: everything that has been planned, fixed (eq. 2).
        work: all skills, in the order of planning.
        placed: part to the end of the skill that places it, in the order of planning [s].
    """

    world: FixedWorld
    work: tuple[PlannedTask, ...] = ()
    placed: Mapping[str, float] = field(default_factory=dict)

    @property
    def step(self) -> int:
        """Number of the part that is planned next."""
        return len(self.placed) + 1

    def moved(
        self, robot: str, time: Array, path: Array, *, work: bool = True
    ) -> Building:
        """Return the state in which a robot has gone along a path.

        Args:
            robot: its name.
            time: of the waypoints, shape (w,) [s].
            path: waypoints, shape (w, n).
            work: False for a way out of others' way.
        """
        line = self.world.robots[robot].then(time, path, work=work)
        return replace(self, world=self.world.with_robot(line))

    def worked(
        self,
        motion: SkillMotion,
        kind: str,
        part: str,
        start: float,
        holder: str | None,
        pose: Transform,
        touching: Pairs,
    ) -> Building:
        """Return the state in which a robot has done a skill.

        Args:
            motion: of the skill.
            kind: ``"pick"``, ``"place-down"`` or ``"handover"``.
            part: what changes hands.
            start: of the skill [s].
            holder: who holds it then.
            pose: of its centre in the holder's flange frame, or in the world.
            touching: unordered pairs of entities that may touch meanwhile.
        """
        time, robot = start + motion.time, motion.robot
        handling = Handling(part, motion.touch, holder, readonly(pose))
        label = f"{_WORDS[kind]} {part}"
        done = PlannedTask(
            robot,
            kind,
            time,
            motion.path,
            self.step,
            label,
            part,
            (handling,),
            touching,
        )
        line = self.world.robots[robot].then(time, motion.path, skill=True)
        item = self.world.objects[part].then(done.touch, holder, pose)
        placed = dict(self.placed)
        if holder is None:
            placed[part] = done.end
        return Building(
            self.world.with_robot(line).with_object(item), (*self.work, done), placed
        )


def nothing_built(problem: ConstructionProblem) -> Building:
    """Return the state in which everything is where it starts."""
    return Building(FixedWorld(problem.cell))


def lying_at(world: FixedWorld, part: str, pose: Transform) -> FixedWorld:
    """Return the world in which a part lies in some place at all times."""
    line = ObjectTimeline(part).then(float("-inf"), None, pose)
    return world.with_object(line)
