"""Construction problems as data: parts with goal poses and grips, and a team of robots.

A ``ConstructionProblem`` is the input of the construction planner (Hartmann et al.). Parts have known start and goal
poses (Sec. III). Robots hold parts by touching them, for example by suction (V-A2). A graph of the contacts between
parts says when each part may be placed (V-A1).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from planning.cell.workcell import CellObject, Workcell
from planning.construction.problem.balance import SiteBalance
from planning.contacts.precedence import PartGraph
from planning.contacts.touching import (
    NEAR,
    PlacedObject,
    nearby_entities,
    standing_fixtures,
)
from planning.statics.standing import StabilityChecker, body_at, ground_bodies
from planning.statics.standing_rules import StandingRules
from planning.steps.skill import Pairs, contacts_with
from planning.tasks.task import ExceptionKey, strongest_exception
from planning.transforms import Array, Transform, inverse, read_only_copy, rotation

_APART = 0.12
"""Least distance of two pads on one part [m]."""


@dataclass(frozen=True)
class PartGrip:
    """A grip of a vacuum tool on a part.

    Attributes:
        touch: pose of the tool frame in the part's frame at turn zero; the tool's z axis points
            into the part and its origin lies on the face.
    """

    touch: Transform

    def held(self, turn: float) -> Transform:
        """Return the pose of the part's centre in the tool frame.

        Args:
            turn: of the tool about its own z axis [rad]. Suction holds at every turn: it is
                free until the part is picked, and stays as it is until it is put down.
        """
        return inverse(self.touch @ rotation("z", turn))


def face_grips(
    size: Array, faces: Sequence[str] = ("+z",), offsets: Sequence[float] = (0.0,)
) -> tuple[PartGrip, ...]:
    """Return grips on the faces of a box: at the middle of each, or offset from it.

    Args:
        size: edge lengths, shape (3,) [m].
        faces: which faces may be touched.
        offsets: distances from the middle along the longer edge of the face [m]; those that
            lie outside of it are left out.
    """
    grips = []
    for offset in offsets:
        for face in faces:
            axis, sign = "xyz".index(face[1]), 1.0 if face[0] == "+" else -1.0
            others = [k for k in range(3) if k != axis]
            along = max(others, key=lambda k: float(size[k]))
            if abs(offset) >= 0.5 * size[along]:
                continue
            touch = np.eye(4)
            touch[:3, :3] = _into(axis, sign, along)
            touch[axis, 3] = sign * 0.5 * size[axis]
            touch[along, 3] = offset
            grips.append(PartGrip(read_only_copy(touch)))
    return tuple(grips)


def _into(axis: int, sign: float, along: int) -> Array:
    """Return tool axes: z into the face, x along its longer edge."""
    z, x = np.zeros(3), np.zeros(3)
    z[axis], x[along] = -sign, 1.0
    return np.column_stack([x, np.cross(z, x), z])


class Hold(NamedTuple):
    """A hold on a part: grip and rotation of the tool.

    Attributes:
        grip: number of the grip.
        turn: of the tool about its z axis [rad].
    """

    grip: int
    turn: float


@dataclass(frozen=True)
class Part:
    """A part and its goal pose.

    Attributes:
        name: of the object in the cell, which has its size, mass and start pose.
        goal: pose of its centre in the world once it is in place.
        grips: where it can be touched.
        insertion: direction of the straight path on which it reaches its place, a unit vector
            in the world, shape (3,).
    """

    name: str
    goal: Transform
    grips: tuple[PartGrip, ...]
    insertion: Array = field(default_factory=lambda: read_only_copy((0.0, 0.0, -1.0)))

    def grips_apart(self, a: int, b: int) -> bool:
        """Tell whether two pads fit on the part together, by the numbers of their grips."""
        gap = self.grips[a].touch[:3, 3] - self.grips[b].touch[:3, 3]
        return bool(np.linalg.norm(gap) >= _APART)


@dataclass(frozen=True)
class SkillSeconds:
    """Nominal durations of the phases of a skill in which the tool stands still [s].

    Attributes:
        pick: a part is picked.
        place: a part is put down.
        handover: a part changes hands, for both robots.
        exceptions: durations that hold instead where a robot does a skill, or where it is done to
            a type of parts; a handover is the giver's.
    """

    pick: float = 2.0
    place: float = 3.0
    handover: float = 4.0
    exceptions: Mapping[ExceptionKey, float] = field(default_factory=dict)

    def of(self, skill: str, robot: str, kind: str) -> float:
        """Return the duration of a robot's skill on a part of a given type [s]."""
        found = strongest_exception(self.exceptions, skill, robot, kind)
        if found is not None:
            return found
        return {
            "pick": self.pick,
            "place-down": self.place,
            "handover": self.handover,
        }[skill]


@dataclass(frozen=True, eq=False)
class ConstructionProblem:
    """A construction problem: parts, their order, and the team of robots.

    Attributes:
        cell: robots, fixtures and objects; every part is an object of it, other objects are
            scenery. HOME is where robots start, and where they park.
        parts: everything that is placed, in the order of the scenario.
        graph: which parts touch each other and the ground in their places.
        frame: name of the tool frame that touches the parts.
        seconds: nominal durations of the skills.
        approach: straight path before and after a touch, and of a part before it reaches and
            after it leaves a place [m].
        carried: whether a part waits for everything that it rests on, see PartGraph.placeable.
        statics: friction and joints by which everything must always stand; None if that is not
            looked at.
        seed: of everything that is drawn.
        idle: robots that only stand where they are.
    """

    cell: Workcell
    parts: tuple[Part, ...]
    graph: PartGraph
    frame: str = "tool"
    seconds: SkillSeconds = field(default_factory=SkillSeconds)
    approach: float = 0.1
    carried: bool = True
    statics: StandingRules | None = None
    seed: int = 0
    idle: frozenset[str] = frozenset()

    @cached_property
    def balance(self) -> SiteBalance:
        """Stability precedence of the parts."""
        standing = None
        if self.statics is not None:
            bodies = {p.name: body_at(self.object(p), p.goal) for p in self.parts}
            standing = StabilityChecker(
                bodies, ground_bodies(self.cell, bodies), self.statics
            )
        return SiteBalance(self.graph, carried=self.carried, standing=standing)

    @cached_property
    def team(self) -> tuple[str, ...]:
        """Names of the robots that work."""
        names = (robot.name for robot in self.cell.robots)
        return tuple(name for name in names if name not in self.idle)

    def part(self, name: str) -> Part:
        """Return the part called ``name``; KeyError lists no choices: names are checked."""
        for part in self.parts:
            if part.name == name:
                return part
        raise KeyError(f"no part {name!r}")

    @cached_property
    def start_contacts(self) -> Mapping[str, Pairs]:
        """Contacts of each part in the supply when it is picked, as pairs of names."""
        fixed = standing_fixtures(self.cell)
        starts: dict[str, PlacedObject] = {
            o.name: (o, o.start) for o in self.cell.objects
        }
        out = {}
        for part in self.parts:
            # What lies on it has been taken before: from then on it is in somebody's hand.
            gone = {part.name, *self.graph.covers.get(part.name, ())}
            others = {k: v for k, v in starts.items() if k not in gone} | fixed
            near = nearby_entities(starts[part.name], others, NEAR)
            out[part.name] = contacts_with(part.name, near)
        return out

    @cached_property
    def goal_contacts(self) -> Mapping[str, Pairs]:
        """Contacts of each part in its place, as pairs of names."""
        placed: dict[str, PlacedObject] = {
            o.name: (o, o.start) for o in self.cell.objects
        }
        placed |= {part.name: (self.object(part), part.goal) for part in self.parts}
        placed |= standing_fixtures(self.cell)
        out = {}
        for part in self.parts:
            others = {k: v for k, v in placed.items() if k != part.name}
            out[part.name] = contacts_with(
                part.name, nearby_entities(placed[part.name], others, NEAR)
            )
        return out

    def seconds_of(self, skill: str, robot: str, part: Part) -> float:
        """Return the nominal duration of a robot's skill on a part [s]."""
        return self.seconds.of(skill, robot, self.object(part).kind)

    def object(self, part: Part) -> CellObject:
        """Return the cell object of a part."""
        return self.cell.object(part.name)

    def tool_pose(self, part: Part, at: Transform, grip: int, turn: float) -> Transform:
        """Return the pose of the tool when it touches a part.

        Args:
            part: what is touched.
            at: pose of the part's centre in the world.
            grip: number of the grip.
            turn: of the tool about its z axis [rad].
        """
        return np.asarray(at @ part.grips[grip].touch @ rotation("z", turn))

    def held_in_flange(
        self, robot: str, part: Part, grip: int, turn: float
    ) -> Transform:
        """Return the pose of a part's centre in the flange frame of the robot that holds it."""
        tool = self.cell.robot(robot).model.frame_in_flange(self.frame)
        return read_only_copy(tool @ part.grips[grip].held(turn))
