"""Workcell (robots, fixtures and objects, all static) and world state (the state of a cell at one instant)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from planning.cell.motion_limits import MotionLimits
from planning.cell.robot_model import RobotModel
from planning.cell.shape import Shape
from planning.transforms import Array, Transform

CONTACT_DEPTH = 0.003
"""Default of the greatest penetration depth of two bodies with an allowed contact [m]."""


@dataclass(frozen=True)
class PoseError:
    """Bound on the deviation of a frame from its nominal pose.

    Its origin is anywhere within ``m``, and it is turned about any axis by up to ``rad``. So a point
    at distance d from the origin is within m + d * rad: by less only as an arc is longer than its
    chord.

    Attributes:
        m: [m].
        rad: [rad].
    """

    m: float = 0.0
    rad: float = 0.0

    def __bool__(self) -> bool:
        """Tell whether the error is not zero."""
        return self.m > 0.0 or self.rad > 0.0

    def displacement(self, distance: float) -> float:
        """Return the largest displacement of a point at a distance from the origin [m]."""
        return self.m + self.rad * distance


NO_ERROR = PoseError()
"""Error of a frame that is exactly at its nominal pose."""


@dataclass(frozen=True, eq=False)
class PlacedRobot:
    """A robot of the cell.

    Attributes:
        name: unique in the cell.
        model: the robot type; of a robot that changes its tools, the arm alone.
        base: pose of its base in the world.
        home: its HOME configuration, shape (n,).
        tool: name of its tool, None where none is named; of a robot that changes its tools, the
            one that it carries at the start.
        tools: those that it changes; none for a robot that keeps its own.
        limits: its motion limits; None where it reaches full speed immediately.
        base_error: how far its base may be from ``base``: what calibration leaves.
        mounted_on: fixtures that are links of its description, which other robots share. What its first joint
            moves may touch them, and what overlaps them at HOME.
    """

    name: str
    model: RobotModel
    base: Transform
    home: Array
    tool: str | None = None
    tools: tuple[RackTool, ...] = ()
    limits: MotionLimits | None = None
    base_error: PoseError = NO_ERROR
    mounted_on: tuple[Fixture, ...] = ()


@dataclass(frozen=True, eq=False)
class Fixture:
    """Something immovable: table, plate, shelf, jig.

    Attributes:
        name: unique among fixtures and objects.
        shape: its shape.
        pose: of the frame of its shape in the world; of a box, that is its centre.
        frames: places on it where processes are done, by name, each in the frame of its shape.
        colour: (r, g, b), 0 to 255, for pictures; None for a grey.
    """

    name: str
    shape: Shape
    pose: Transform
    frames: Mapping[str, Transform] = field(default_factory=dict)
    colour: tuple[int, int, int] | None = None

    @property
    def size(self) -> Array:
        """Edge lengths of the box around it, in its own frame, shape (3,) [m]."""
        return self.shape.size


@dataclass(frozen=True, eq=False)
class CellObject:
    """An object that can be handled, or that stays as scenery.

    Attributes:
        name: unique among fixtures and objects.
        kind: its type, such as ``"2x4"``; objects of one kind are interchangeable.
        shape: its shape.
        start: pose of the frame of its shape in the world where it first is; of a box, that is
            its centre.
        mass: [kg].
        fixed: True for scaffolding that no step may use.
        colour: (r, g, b), 0 to 255, for pictures.
        later: True when it is not there at the start. It comes up, at rest at ``start``, by a
            handling without a holder: the next brick of a feeding station.
    """

    name: str
    kind: str
    shape: Shape
    start: Transform
    mass: float = 0.0
    fixed: bool = False
    colour: tuple[int, int, int] = (200, 60, 50)
    later: bool = False

    @property
    def size(self) -> Array:
        """Edge lengths of the box around it, in its own frame, shape (3,) [m]."""
        return self.shape.size


@dataclass(frozen=True, eq=False)
class RackTool:
    """A tool that a robot takes from its rack and leaves there: an object that is handled.

    Attributes:
        item: the tool as an object of the cell, in the frame of its root link.
        mount: pose of it in the flange frame of the robot that carries it.
        rack: pose of it in the world where it lies in its rack.
        approach: straight path of the robot into the rack and out of it [m].
        seconds: that it takes to lock it on a flange, or to let go of it [s].
        model: the robot with this tool mounted as a part of its body.
    """

    item: CellObject
    mount: Transform
    rack: Transform
    approach: float
    seconds: float
    model: RobotModel

    @property
    def name(self) -> str:
        """Its name in the cell."""
        return self.item.name


@dataclass(frozen=True)
class Clearances:
    """Least distances that are kept.

    Attributes:
        robot_robot: between two robots, with their tools and all that they carry [m].
        robot_object: between a robot, or its load, and anything else [m].
        contact_tolerance: how deep a tool may graze a brick at rest within a LEGO skill. The
            default is the gap by which a brick is shorter than its studs times the pitch, 0.1 mm
            on each side: the play that bricks leave each other on their studs [m].
        contact_depth: how deep objects that are meant to touch may be in each other, and in
            fixtures [m].
    """

    robot_robot: float = 0.001
    robot_object: float = 0.0
    contact_tolerance: float = 0.0002
    contact_depth: float = CONTACT_DEPTH


@dataclass(frozen=True)
class Begun:
    """Progress made before a plan that begins neither at HOME nor with all objects at their start.

    Attributes:
        after: what was executed, for people.
        done: tasks that were done of each kind of process or skill, as often as they were.
        out: robots that are out: their HOME is where they stand.
        steps: numbers of the steps of which all is done but transits.
    """

    after: str
    done: tuple[tuple[str, int], ...] = ()
    out: tuple[str, ...] = ()
    steps: tuple[int, ...] = ()


@dataclass(frozen=True)
class Workcell:
    """Static description of a cell: everything that does not change during operation.

    Attributes:
        robots: the robots that do the work.
        fixtures: what never moves.
        objects: what is handled, and what lies there until the end.
        clearances: least distances that are kept.
        machines: bring parts, work at them where they lie, and take products away; they have
            chains in graphs as robots do, and no bodies.
        deviations: by skill, how far a robot's flange may be from the reference path while the
            skill is executed; none for skills that follow it.
        begun: what was done before; None where plans begin with all robots at HOME and all objects at
            their starts. Robots then begin where their chains do, objects where they lie by then.
    """

    robots: tuple[PlacedRobot, ...]
    fixtures: tuple[Fixture, ...]
    objects: tuple[CellObject, ...]
    clearances: Clearances = field(default_factory=Clearances)
    machines: tuple[PlacedRobot, ...] = ()
    deviations: Mapping[str, PoseError] = field(default_factory=dict)
    begun: Begun | None = None

    def robot(self, name: str) -> PlacedRobot:
        """Return the robot or machine called ``name``; KeyError lists the names."""
        for robot in (*self.robots, *self.machines):
            if robot.name == name:
                return robot
        raise KeyError(f"no robot {name!r}; robots: {[r.name for r in self.robots]}")

    def is_machine(self, name: str) -> bool:
        """Tell whether a name is that of a machine, not of a robot."""
        return any(item.name == name for item in self.machines)

    def object(self, name: str) -> CellObject:
        """Return the object called ``name``."""
        for item in self.objects:
            if item.name == name:
                return item
        raise KeyError(f"no object {name!r}")

    def kind_of(self, name: str) -> str | None:
        """Return the kind of an object; of a station's copy that is absent, that of the object it copies.

        Copies are named after their object, with a number: ``brick.2``.
        """
        known = {item.name: item.kind for item in self.objects}
        while name and name not in known:
            name = name.rpartition(".")[0]
        return known.get(name)

    def start_state(self) -> WorldState:
        """Return the state in which every robot is at HOME and every object at its start.

        It has no objects that arrive later.
        """
        return WorldState(
            {r.name: r.home for r in self.robots},
            {o.name: Attachment(None, o.start) for o in self.objects if not o.later},
        )


@dataclass(frozen=True, eq=False)
class Attachment:
    """Location of an object: held by a robot, or at rest.

    Attributes:
        holder: name of the robot that holds it, None at rest.
        pose: of the frame of the object's shape in the holder's flange frame, or in the world.
    """

    holder: str | None
    pose: Transform


@dataclass(frozen=True)
class WorldState:
    """State of a cell at one instant.

    Attributes:
        configurations: robot name to joint values, each of shape (n,).
        attachments: object name to where it is; an object that is not there yet has none.
    """

    configurations: Mapping[str, Array]
    attachments: Mapping[str, Attachment]

    def with_robot(self, name: str, q: Array) -> WorldState:
        """Return the state with one robot at ``q``, shape (n,)."""
        return WorldState({**self.configurations, name: q}, self.attachments)
