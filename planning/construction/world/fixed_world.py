"""The fixed world: the cell with all motion planned so far (Hartmann et al., eq. 2)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

from planning.cell.workcell import Attachment, Workcell, WorldState
from planning.construction.world.kept_tracks import SweptTracks
from planning.construction.world.timeline import ObjectTimeline, RobotTimeline


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
        """Time from which on nothing moves any more [s]."""
        return max((line.end for line in self.robots.values()), default=0.0)

    def free_from(self, robot: str) -> float:
        """Return the time at which a robot has done its work: T_r of eq. (2) [s].

        A way out of others' way may follow, see ``without_way_out``.
        """
        return self.robots[robot].busy_until

    def state_at(self, t: float) -> WorldState:
        """Return the state of the cell at time ``t`` [s]."""
        attachments: dict[str, Attachment] = {}
        for item in self.cell.objects:
            found = self.objects[item.name].at(t)
            if found is None and not item.later:
                found = Attachment(None, item.start)
            if found is not None:
                attachments[item.name] = found
        return WorldState(
            {name: line.at(t) for name, line in self.robots.items()}, attachments
        )

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
