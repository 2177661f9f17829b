"""Construction problems as data: parts with goal poses and grips, and the team.

Everything in the construction route takes one ConstructionProblem: parts whose start and goal
poses are known (Hartmann et al. III), robots that hold them by touch (V-A2), and the graph that
says which part may be placed when (V-A1).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from planning.cell.workcell import CellObject, PlacedRobot, Workcell
from planning.construction.problem.precedence import PartGraph
from planning.kinematics.kinematics import frame_in_flange
from planning.transforms import Array, Transform, inverse, readonly, rotation


@dataclass(frozen=True)
class PartGrip:
    """A grip of a vacuum tool on a part.

    Attributes:
        touch: pose of the tool frame in the part's frame at turn zero; the tool's z axis points
            into the part and its origin lies on the face.
        words: what it is, for messages: ``"top"``, ``"top +150 mm along x"``.
    """

    touch: Transform
    words: str

    def held(self, turn: float) -> Transform:
        """Return the pose of the part's centre in the tool frame.

        Args:
            turn: of the tool about its own z axis [rad]. Suction holds at every turn: it is
                free until the part is picked, and stays as it is until it is put down.
        """
        return inverse(self.touch @ rotation("z", turn))


@dataclass(frozen=True)
class Part:
    """A part and its goal pose.

    Attributes:
        name: of the object in the cell, which has its size, mass and start pose.
        goal: pose of its centre in the world once it is in place.
        grips: where it can be touched.
        insertion: direction of the straight way on which it reaches its place, a unit vector
            in the world, shape (3,).
    """

    name: str
    goal: Transform
    grips: tuple[PartGrip, ...]
    insertion: Array = field(default_factory=lambda: readonly((0.0, 0.0, -1.0)))


@dataclass(frozen=True)
class SkillSeconds:
    """Nominal durations of the moments in which a tool stands still [s].

    Attributes:
        pick: a part is taken up.
        place: a part is put down.
        handover: a part changes hands, for both robots.
    """

    pick: float = 2.0
    place: float = 3.0
    handover: float = 4.0


@dataclass(frozen=True, eq=False)
class ConstructionProblem:
    """A construction problem: parts, their order, and the team of robots.

    Attributes:
        cell: robots, fixtures and objects; every part is an object of it, other objects are
            scenery. HOME is where robots start, and where they park.
        parts: everything that is placed, in the order of the scenario.
        graph: which parts touch each other and the ground in their places.
        team: names of the robots that take part.
        frame: name of the tool frame that touches the parts.
        seconds: nominal durations of the skills.
        approach: straight way before and after a touch, and of a part before it reaches and
            after it leaves a place [m].
        speeds: joint speed limits by robot, each of shape (n,) [rad/s or m/s].
        carried: whether a part waits for everything that it rests on, see PartGraph.placeable.
        seed: of everything that is drawn.
    """

    cell: Workcell
    parts: tuple[Part, ...]
    graph: PartGraph
    team: tuple[str, ...]
    frame: str = "tool"
    seconds: SkillSeconds = field(default_factory=SkillSeconds)
    approach: float = 0.1
    speeds: Mapping[str, Array] = field(default_factory=dict)
    carried: bool = True
    seed: int = 0

    def part(self, name: str) -> Part:
        """Return the part called ``name``; KeyError lists no choices: names are checked."""
        for part in self.parts:
            if part.name == name:
                return part
        raise KeyError(f"no part {name!r}")

    def object(self, part: Part) -> CellObject:
        """Return the object that a part is."""
        return self.cell.object(part.name)

    def robots(self) -> tuple[PlacedRobot, ...]:
        """Return the robots of the team, in its order."""
        return tuple(self.cell.robot(name) for name in self.team)

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
        tool = frame_in_flange(self.cell.robot(robot).model, self.frame)
        return readonly(tool @ part.grips[grip].held(turn))
