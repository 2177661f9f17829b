"""The fixed world: the cell with all motion planned so far (Hartmann et al., eq. 2)."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from planning.cell.workcell import CellObject, PlacedRobot, Workcell
from planning.construction.world.motion_pieces import STEP, cut_timeline
from planning.construction.world.swept_track import SweptTrack, sweep_track
from planning.construction.world.timeline import (
    HandChange,
    ObjectTimeline,
    RobotTimeline,
)
from planning.transforms import Transform

_KEPT = 64
"""Number of cached timelines: a few of each robot of the largest teams."""

_Key = tuple[RobotTimeline, tuple[HandChange, ...]]


class SweptTracks:
    """Keeps the swept tracks of the timelines that were used last.

    While one robot is planned nobody else's timeline changes, and half a dozen checkers are made.
    """

    def __init__(self) -> None:
        self._kept: OrderedDict[_Key, tuple[float, SweptTrack]] = OrderedDict()

    def since(
        self,
        start: float,
        robot: PlacedRobot,
        line: RobotTimeline,
        changes: Sequence[HandChange],
        item: Callable[[str], CellObject],
    ) -> SweptTrack:
        """Return the swept track of a robot from the cell of time on that ``start`` is in.

        Args:
            start: [s].
            robot: who moves.
            line: how.
            changes: what it holds from when on.
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


class Rest(NamedTuple):
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
    """Timelines of all robots and objects. Never changed: planning on makes a new one.

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
        """Copy and freeze both mappings; fill in robots and objects that are missing."""
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

    @property
    def end(self) -> float:
        """End of the last motion [s]."""
        return max((line.end for line in self.robots.values()), default=0.0)

    def free_from(self, robot: str) -> float:
        """Return the time at which a robot has done its work: T_r of eq. (2) [s].

        A way out of others' way may follow, see ``without_way_out``.
        """
        return self.robots[robot].busy_until

    def rests(self, name: str) -> list[Rest]:
        """Return the rests of an object, in order."""
        item = self.cell.object(name)
        changes = self.objects[name].changes
        out: list[Rest] = []
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
                out.append(Rest(name, since, end, pose))
                resting = False
            holder = change.holder
        if resting:
            out.append(Rest(name, since, np.inf, pose))
        return out

    def with_robot(self, timeline: RobotTimeline) -> FixedWorld:
        """Return the world with another timeline of a robot."""
        self.cell.robot(timeline.robot)
        return replace(self, robots={**self.robots, timeline.robot: timeline})

    def with_object(self, timeline: ObjectTimeline) -> FixedWorld:
        """Return the world with another timeline of an object."""
        self.cell.object(timeline.object)
        return replace(self, objects={**self.objects, timeline.object: timeline})

    def without_way_out(self, robot: str) -> FixedWorld:
        """Return the world without a robot's way out of others' way: it gets new work.

        Others may have been planned on the strength of it, so the robot must be planned anew from
        there at once, in the world that this returns.
        """
        return self.with_robot(self.robots[robot].work())
