"""States of the search: fixed timelines, and the skills that have been planned."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from planning.construction.problem.problem import ConstructionProblem
from planning.construction.world.fixed_world import FixedWorld
from planning.construction.world.skill_motion import SkillMotion
from planning.construction.world.timeline import ObjectTimeline
from planning.transforms import Array, Transform


@dataclass(frozen=True)
class Work:
    """A skill that has been planned.

    Attributes:
        robot: who does it.
        kind: ``"pick"``, ``"place-down"`` or ``"handover"``.
        part: what it is about.
        step: number of the part in the order of planning, from 1.
        start, end: of the skill [s].
        touch: when the part changes hands [s].
        holder: who holds it from then on, None when it is put down.
        pose: of its centre in the holder's flange frame, or in the world.
        grip: number of the grip by which the robot holds or held it.
    """

    robot: str
    kind: str
    part: str
    step: int
    start: float
    end: float
    touch: float
    holder: str | None
    pose: Transform
    grip: int


@dataclass(frozen=True)
class Building:
    """A state of the search. Never changed: planning on makes a new one.

    Attributes:
        world: everything that has been planned, fixed (eq. 2).
        work: all skills, in the order of planning.
        placed: part to the end of the skill that places it, in the order of planning [s].
    """

    world: FixedWorld
    work: tuple[Work, ...] = ()
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
        grip: int,
    ) -> Building:
        """Return the state in which a robot has done a skill.

        Args:
            motion: of the skill.
            kind: see Work.
            part: what changes hands.
            start: of the skill [s].
            holder: who holds it then.
            pose: see Work.
            grip: see Work.
        """
        time = start + motion.time
        touch = float(time[motion.touch])
        line = self.world.robots[motion.robot].then(time, motion.path, skill=True)
        item = self.world.objects[part].then(touch, holder, pose)
        done = Work(
            motion.robot,
            kind,
            part,
            self.step,
            float(time[0]),
            float(time[-1]),
            touch,
            holder,
            pose,
            grip,
        )
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
    """Return the world in which a part has been in some place for ever."""
    line = ObjectTimeline(part).then(float("-inf"), None, pose)
    return world.with_object(line)
