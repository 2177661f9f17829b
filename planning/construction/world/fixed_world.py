"""The fixed world (Hartmann et al., eq. 2): the workcell with all motions planned so far."""

from __future__ import annotations

import operator
from collections import OrderedDict
from collections.abc import Callable, Collection, Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from planning.cell.shape import Placed
from planning.cell.workcell import CellObject, PlacedRobot, Workcell
from planning.construction.problem.problem import ConstructionProblem
from planning.construction.world.fleet import LoadedRobot
from planning.construction.world.skill_motion import SkillMotion
from planning.construction.world.timeline import (
    STEP,
    HandChange,
    ObjectTimeline,
    RobotTimeline,
    cut_timeline,
    held_objects_over_time,
)
from planning.construction.world.tracks import (
    SweptTrack,
    Tracks,
    build_tracks,
    sweep_track,
)
from planning.geometry.standing import StandingBoxes
from planning.handling.skill_contacts import NOTHING
from planning.steps.skill import Pairs
from planning.tasks.task import Handling
from planning.transforms import Array, Transform, read_only_copy

_KEPT = 64
"""Number of cached timelines: a few of each robot of the largest teams."""

_Skills = tuple[tuple[float, float], ...]

_JOINED = 4
"""Number of cached sets of tracks of many robots: the checkers of one skill share one of them."""

_Key = tuple[RobotTimeline, tuple[HandChange, ...]]

Follower = tuple[PlacedRobot, RobotTimeline, Sequence[HandChange]]
"""A robot, its timeline, and the objects it holds over time."""

_WORDS = {"pick": "pick", "place-down": "place", "handover": "hand over"}


class SweptTracks:
    """Cache of the swept tracks of recently used timelines, and of resting objects.

    While one robot is planned nobody else's timeline changes, and half a dozen checkers are made.

    Attributes:
        rests: of each object, and the timelines of which that was computed.
    """

    def __init__(self) -> None:
        self._kept: OrderedDict[_Key, tuple[float, SweptTrack]] = OrderedDict()
        self.rests: dict[str, tuple[ObjectTimeline, list[_Skills], list[TimedRest]]]
        self.rests = {}
        self._joined: OrderedDict[
            tuple[float, tuple[_Key, ...]], tuple[list[LoadedRobot], Tracks]
        ] = OrderedDict()

    def joined(
        self,
        start: float,
        robots: Sequence[Follower],
        item: Callable[[str], CellObject],
    ) -> tuple[list[LoadedRobot], Tracks]:
        """Return the tracks of some robots from a time on, after one other carrier, and their carriers.

        Args:
            start: see ``since`` [s].
            robots: moving robots with timelines and loads.
            item: returns an object by its name.
        """
        key = start, tuple((line, tuple(changes)) for _, line, changes in robots)
        known = self._joined.get(key)
        if known is None:
            swept = [self.since(start, *robot, item) for robot in robots]
            carriers = [carrier for track in swept for carrier in track.carriers]
            known = self._joined[key] = carriers, build_tracks(swept, 1)
            if len(self._joined) > _JOINED:
                self._joined.popitem(last=False)
        self._joined.move_to_end(key)
        return known

    def since(
        self,
        start: float,
        robot: PlacedRobot,
        line: RobotTimeline,
        changes: Sequence[HandChange],
        item: Callable[[str], CellObject],
    ) -> SweptTrack:
        """Return the swept track of a robot from the time cell of ``start`` on.

        Args:
            start: [s].
            robot: the moving robot.
            line: how.
            changes: the objects it holds from each time on.
            item: returns an object by its name.
        """
        key = (line, tuple(changes))
        known = self._kept.get(key)
        if known is None or known[0] > start:
            first = float(np.floor(start / STEP) * STEP)
            times = [t for t, _ in changes[1:]]
            pieces = cut_timeline(line, first, np.inf, STEP, times)
            known = first, sweep_track(robot, pieces, changes, item)
            self._kept[key] = known
            if len(self._kept) > _KEPT:
                self._kept.popitem(last=False)
        self._kept.move_to_end(key)
        return known[1].since(start)


class TimedRest(NamedTuple):
    """An object at rest at one pose during a span of time.

    Attributes:
        object: its name.
        start, end: when [s]: from the beginning of the skill that puts it there to the end of
            the skill that takes it away.
        pose: of its centre in the world.
    """

    object: str
    start: float
    end: float
    pose: Transform


@dataclass(frozen=True)
class FixedWorld:
    """Timelines of all robots and objects; immutable, extended by copies.

    Attributes:
        cell: the static cell.
        robots: timeline of each robot, by name; one without stands at HOME.
        objects: timeline of each object, by name; one without stays where it starts.
        swept: remembers what robots sweep, for all worlds made from one another.
    """

    cell: Workcell
    robots: Mapping[str, RobotTimeline] = field(default_factory=dict)
    objects: Mapping[str, ObjectTimeline] = field(default_factory=dict)
    swept: SweptTracks = field(default_factory=SweptTracks, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Copy and freeze both mappings; fill in missing robots and objects."""
        robots = {
            r.name: self.robots.get(r.name) or RobotTimeline(r.name, [0.0], [r.home])  # type: ignore[arg-type]
            for r in self.cell.robots
        }
        objects = {
            o.name: self.objects.get(o.name) or ObjectTimeline(o.name)
            for o in self.cell.objects
        }
        object.__setattr__(self, "robots", MappingProxyType(robots))
        object.__setattr__(self, "objects", MappingProxyType(objects))

    def __reduce__(self) -> tuple[Any, ...]:
        """Return how to rebuild it in another process."""
        return type(self), (self.cell, dict(self.robots), dict(self.objects))

    @cached_property
    def hands(self) -> Mapping[str, list[HandChange]]:
        """The objects that each robot holds over time."""
        held = held_objects_over_time(self.objects)
        return {name: held.get(name, [(-np.inf, ())]) for name in self.robots}

    def hands_without(self, names: Collection[str]) -> Mapping[str, list[HandChange]]:
        """Return the objects that each robot holds over time, without some of them."""
        key = frozenset(names)
        if key not in self._hands_without:
            self._hands_without[key] = {
                robot: [
                    (t, tuple((name, at) for name, at in hand if name not in key))
                    for t, hand in changes
                ]
                for robot, changes in self.hands.items()
            }
        return self._hands_without[key]

    @cached_property
    def _hands_without(
        self,
    ) -> dict[frozenset[str], Mapping[str, list[HandChange]]]:
        return {}

    @cached_property
    def pieces_at_rest(self) -> list[tuple[list[Placed], TimedRest]]:
        """All rests of objects, each with the pieces of the object at its pose."""
        return [
            (item.shape.placed(item.name, rest.pose), rest)
            for item in self.cell.objects
            for rest in self.rests(item.name)
        ]

    @cached_property
    def still_boxes(self) -> dict[Hashable, tuple[StandingBoxes, tuple[Array, Array]]]:
        """Boxes of obstacles of a robot, and when each appears and disappears, by what it holds and its start."""
        return {}

    @property
    def end(self) -> float:
        """End of the last motion [s]."""
        return max((line.end for line in self.robots.values()), default=0.0)

    def free_from(self, robot: str) -> float:
        """Return the time at which a robot has finished its work: T_r of eq. (2) [s].

        A retreat out of others' way may follow, see ``without_retreat``.
        """
        return self.robots[robot].busy_until

    def rests(self, name: str) -> list[TimedRest]:
        """Return the rests of an object, in order."""
        line = self.objects[name]
        # Its history is in its own timeline and in the skills of its holders.
        by = [self.robots[c.holder].skills for c in line.changes if c.holder]
        known = self.swept.rests.get(name)
        if known is None or not (
            known[0] is line and all(map(operator.is_, known[1], by))
        ):
            known = self.swept.rests[name] = line, by, self._rests(name)
        return known[2]

    def _rests(self, name: str) -> list[TimedRest]:
        item = self.cell.object(name)
        changes = self.objects[name].changes
        out: list[TimedRest] = []
        since, pose = (-np.inf, item.start)
        resting = not item.later
        holder: str | None = None
        for change in changes:
            if change.holder is None:
                begin = change.time
                if holder is not None:
                    begin = self.robots[holder].skill_at(change.time)[0]
                since, pose, resting = begin, change.pose, True
            elif resting:
                end = self.robots[change.holder].skill_at(change.time)[1]
                out.append(TimedRest(name, since, end, pose))
                resting = False
            holder = change.holder
        if resting:
            out.append(TimedRest(name, since, np.inf, pose))
        return out

    def with_robot(self, timeline: RobotTimeline) -> FixedWorld:
        """Return the world with another timeline of a robot."""
        self.cell.robot(timeline.robot)
        return replace(self, robots={**self.robots, timeline.robot: timeline})

    def with_object(self, timeline: ObjectTimeline) -> FixedWorld:
        """Return the world with another timeline of an object."""
        self.cell.object(timeline.object)
        return replace(self, objects={**self.objects, timeline.object: timeline})

    def without_retreat(self, robot: str) -> FixedWorld:
        """Return the world without a robot's last retreat, because it gets new work.

        Others may have been planned on the strength of it, so the robot must be replanned from
        there at once, in the world that this returns.
        """
        return self.with_robot(self.robots[robot].work())


@dataclass(frozen=True)
class PlannedTask:
    """A task of one robot at its place in space-time.

    Attributes:
        robot: the robot.
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
        object.__setattr__(self, "time", read_only_copy(self.time))
        object.__setattr__(self, "path", read_only_copy(np.atleast_2d(self.path)))

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
        """Time at which the object of a skill changes hands [s]."""
        return float(self.time[self.handlings[0].waypoint])

    @property
    def holder(self) -> str | None:
        """Robot that holds the object after the skill, None when it is put down."""
        return self.handlings[0].holder


class HeldPlacement(NamedTuple):
    """A part that is held by the robot that placed it until another part is in place.

    Attributes:
        robot: the robot; it stands.
        exit_path: path by which it then leaves the part, shape (w, n).
        last: the part that has to be in place before; empty as long as that is open.
        end: when the robot lets go [s].
    """

    robot: str
    exit_path: Array
    last: str = ""
    end: float = np.inf


@dataclass(frozen=True)
class BuildState:
    """A state of the search; immutable, extended by copies.

    Attributes:
        world: everything that has been planned, fixed (eq. 2).
        work: all skills, in the order of planning.
        placed: part to the end of the skill that places it, in the order of planning [s].
        kept: parts that are held in their places, or were.
    """

    world: FixedWorld
    work: tuple[PlannedTask, ...] = ()
    placed: Mapping[str, float] = field(default_factory=dict)
    kept: Mapping[str, HeldPlacement] = field(default_factory=dict)

    @property
    def step(self) -> int:
        """Number of the part that is planned next."""
        return len(self.placed) + 1

    def moved(
        self, robot: str, time: Array, path: Array, *, work: bool = True
    ) -> BuildState:
        """Return the state after a robot has followed a path.

        Args:
            robot: its name.
            time: of the waypoints, shape (w,) [s].
            path: waypoints, shape (w, n).
            work: False for a retreat out of others' way.
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
    ) -> BuildState:
        """Return the state after a robot has done a skill.

        Args:
            motion: of the skill.
            kind: ``"pick"``, ``"place-down"`` or ``"handover"``.
            part: what changes hands.
            start: of the skill [s].
            holder: the robot that holds it then.
            pose: of its centre in the holder's flange frame, or in the world.
            touching: unordered pairs of entities that may touch meanwhile.
        """
        time, robot = start + motion.time, motion.robot
        handling = Handling(part, motion.touch, holder, read_only_copy(pose))
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
        return BuildState(
            self.world.with_robot(line).with_object(item),
            (*self.work, done),
            placed,
            self.kept,
        )


def initial_build_state(problem: ConstructionProblem) -> BuildState:
    """Return the initial state, with everything at its start."""
    return BuildState(FixedWorld(problem.cell))


def with_part_at_rest(world: FixedWorld, part: str, pose: Transform) -> FixedWorld:
    """Return the world in which a part rests at a pose at all times."""
    line = ObjectTimeline(part).then(float("-inf"), None, pose)
    return world.with_object(line)
