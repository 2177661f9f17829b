"""Scenario section of the cell: robots (listed singly or as a team), tools, fixtures and clearances."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from planning.bounds import (
    FASTEST,
    HEAVIEST_KG,
    LARGEST_M,
    LONGEST_S,
    MOST_ELEMENTS,
    MOST_OF_TEAM,
    MOST_ROBOTS,
    SLOWEST,
)
from planning.cell.robot_model import ToolGrip
from planning.cell.workcell import Clearances
from planning.errors import ScenarioError
from twin.document.section import Name, PairOf, Section, Several
from twin.durations.bounded import Fixed
from twin.durations.composed import AnyDuration
from twin.durations.model import DurationModel
from twin.scenario.sections.shapes import (
    Colour,
    Configuration,
    Coordinate,
    Length,
    PlacedShapeSection,
    PoseSection,
    ShapedSection,
)
from twin.uncertainty.base_errors import PoseErrorSection

Opening = Annotated[float, Field(ge=0, le=10)]
JointName = Annotated[str, Field(min_length=1, max_length=256)]
PathName = Annotated[str, Field(min_length=1, max_length=4096)]
HeldJoints = dict[JointName, Coordinate]
ActuationTime = AnyDuration | Annotated[float, Field(ge=0, le=LONGEST_S)]

FINGERS_S, SUCTION_S = 0.4, 0.2
"""What fingers take to close or to open, and suction to come on or to go off, where nobody says: an
assumption, and no measurement [s]."""

_Limit = Annotated[float, Field(ge=SLOWEST, le=FASTEST)]
_Effort = Annotated[float, Field(gt=0, le=1e6)]
_ToolSpeed = Annotated[float, Field(ge=SLOWEST, le=1000)]
Vector2 = PairOf[Coordinate]

_OF_A_TEAM = ("model", "tool", "flange", "limits", "joints")
"""What all robots of a team have alike."""


def actuation_model(given: ActuationTime | None, *, suction: bool) -> DurationModel:
    """Return the duration model of a tool's closing or opening."""
    if isinstance(given, DurationModel):
        return given
    usual = SUCTION_S if suction else FINGERS_S
    return Fixed(value_s=usual if given is None else given)


class RackSection(PoseSection):
    """Place of a tool in its rack, and how a robot takes it from there.

    Attributes:
        approach_m: straight way of the robot along its flange's axis into the rack, and out of it.
        change_s: time that it takes to lock the tool on the flange, and to let go of it.
        change: distribution of that time, in place of ``change_s``.
    """

    approach_m: Annotated[float, Field(ge=0.001, le=1)] = 0.1
    change_s: Annotated[float, Field(ge=0, le=LONGEST_S)] = 2.0
    change: AnyDuration | None = None

    not_both = (("change_s", "change"),)

    @property
    def change_time(self) -> AnyDuration:
        """Time that it takes to lock the tool, and to let go of it."""
        return self.change or Fixed(value_s=self.change_s)


class ToolSection(Section):
    """A tool: what it looks like, where it sits on a flange, where it works, and how it holds.

    Attributes:
        description: path of a URDF or MJCF file, relative to the scenario's.
        shapes: what a tool without a description is made of, in place of it: shapes, each in its
            place.
        within_m: how deep a hollow of a mesh of the description may be that convex pieces fill;
            default: each mesh is taken for its convex hull.
        mount: pose of its root link in the flange frame of the robot that carries it.
        tcp: pose of the point at which it works in the frame of its root link: z out of the hand,
            between the fingers; default: its link that is named as one, such as tcp.
        joints: values of its joints [rad or m], at which they are held; what mimics one follows, and
            what is left out is held at zero, or at the limit that is nearest to it.
        closing: axis of the tcp along which its fingers close.
        opening_m: farthest that its fingers open, or least and farthest; 0 for a tool that holds
            nothing. Without it, and without suction, what assembly.grips says holds.
        suction: whether it holds by suction, at one face.
        force_n: with which either finger presses on what it holds; without it nobody looks whether
            friction holds that.
        close_s: time that it takes to close on a part, or suction to hold it: a number or a
            distribution; default: what assembly.grips says.
        open_s: time that it takes to let go, likewise.
        mass_kg: of all of it; default: what its description adds up to.
        frames: further frames by name, each a pose in the frame of its root link.
        rack: pose of its root link where it lies while no robot has it on it; for tools that are
            changed.
    """

    description: Annotated[str, Field(min_length=1, max_length=4096)] | None = None
    shapes: tuple[PlacedShapeSection, ...] = ()
    within_m: Length | None = None
    mount: PoseSection = PoseSection(xyz_m=(0.0, 0.0, 0.0))
    tcp: PoseSection | None = None
    joints: HeldJoints = Field(default_factory=dict)
    closing: Literal["x", "y"] = "y"
    opening_m: Several[Opening] | Opening | None = None
    suction: bool = False
    force_n: Annotated[float, Field(gt=0, le=1e6)] | None = None
    close_s: ActuationTime | None = None
    open_s: ActuationTime | None = None
    mass_kg: Annotated[float, Field(gt=0, le=HEAVIEST_KG)] | None = None
    frames: dict[Name, PoseSection] = Field(default_factory=dict)
    rack: RackSection | None = None

    not_both = (("opening_m", "suction"), ("force_n", "suction"))

    @model_validator(mode="after")
    def _presses(self) -> ToolSection:
        if self.force_n is not None and not self.opening_m:
            raise ValueError("force_n is of fingers: give opening_m as well")
        return self

    @model_validator(mode="after")
    def _check_not_empty(self) -> ToolSection:
        if (self.description is None) == (not self.shapes):
            raise ValueError("give description or shapes, one of them")
        if self.description is None and (self.joints or self.within_m is not None):
            raise ValueError("joints and within_m belong to a description")
        return self

    @model_validator(mode="after")
    def _opens(self) -> ToolSection:
        opening = self.opening_m
        if isinstance(opening, tuple) and (
            len(opening) != 2 or opening[0] >= opening[1]
        ):
            raise ValueError(
                "opening_m is one number, or two: the least and the largest"
            )
        return self

    @property
    def opening(self) -> tuple[float, float] | None:
        """Least and largest distance of its fingers [m]; None where it has none."""
        if isinstance(self.opening_m, tuple):
            return self.opening_m[0], self.opening_m[1]
        return None if self.opening_m is None else (0.0, self.opening_m)

    def grip(self, name: str) -> ToolGrip | None:
        """Return how the tool holds, under its name; None where nothing is said."""
        opening = self.opening
        if not self.suction and opening is None:
            return None
        return ToolGrip(opening, name, self.force_n)


class LimitsSection(Section):
    """Limits of a robot in place of what its description says: one for all joints, or a list.

    Attributes:
        velocity: of joints [rad/s or m/s].
        acceleration: of joints [rad/s^2 or m/s^2].
        jerk: of joints [rad/s^3 or m/s^3].
        effort: of joints [N m or N].
        payload_kg: the most that the robot may carry, its tool included.
        tool_speed_m_s: greatest speed of the tool, whatever it holds, in plans within limits.
        loaded_tool_speed_m_s: the same while it holds a part.
    """

    velocity: Several[_Limit] | _Limit | None = None
    acceleration: Several[_Limit] | _Limit | None = None
    jerk: Several[_Limit] | _Limit | None = None
    effort: Several[_Effort] | _Effort | None = None
    payload_kg: Annotated[float, Field(gt=0, le=HEAVIEST_KG)] | None = None
    tool_speed_m_s: _ToolSpeed | None = None
    loaded_tool_speed_m_s: _ToolSpeed | None = None


class ParkedSection(Section):
    """Pose of a mobile robot at HOME, on the ground of its base frame.

    Attributes:
        at_m: x and y.
        facing_deg: direction of its front, from the x axis towards y.
    """

    at_m: Vector2
    facing_deg: Coordinate = 0.0


class RobotSection(Section):
    """A robot of the cell.

    Attributes:
        name: unique in the cell.
        model: a name that ``twin robots`` lists, or the path of a URDF, xacro or MJCF file, relative
            to the scenario's; package://NAME/PATH is a file of a package of Python or ROS.
        base: pose of the base in the world; that of a mobile robot is the origin of the ground
            it drives on.
        home_deg: HOME of a robot with revolute joints only [deg]; default: the model's.
        home_rad_or_m: HOME of any robot, joint by joint [rad or m].
        parked: where a mobile robot stands at HOME; its arm is as in the model's HOME.
        tool: a tool of the cell, or one of those that the model comes with, such as slim for a gp4;
            default: the one that the model names.
        tools: tools of the cell that it changes at their racks, in place of ``tool``; it has the
            first on it at the start.
        flange: link whose frame is the flange, where its chain ends; default: tool0, else flange, else
            the last link. Robots of one model and base with different flanges are arms of one body.
        limits: of its joints, in place of the model's.
        joints: joints of the model that are held, such as fingers, and at what values [rad or m];
            what mimics one follows. What does not lead to the flange is held in any case.
        srdf: path of the maker's SRDF file; default: the one that lies with the model. false for none:
            what the maker says of pairs of links, HOME and flange is not used.
        home: a pose that the maker names, such as a group state of the SRDF file, as HOME; default: the
            one called home, else ready.
        ignore_contacts: pairs of links of the robot, or of its tool as TOOL.LINK, that may overlap: nothing
            checks them.
        xacro: arguments of a model in xacro, by name.
        frames: tool frames, each a pose in the flange frame; they replace the model's.
        repeatability_m: of its positioning, RP of ISO 9283, with which it puts parts where they
            fit; how often they do is not looked at when not given.
        base_error: what calibration leaves of the base; all is planned with it.
    """

    name: Name
    model: Annotated[str, Field(min_length=1, max_length=4096)]
    tool: Name | None = None
    tools: Annotated[tuple[Name, ...], Field(max_length=20)] = ()
    flange: JointName | None = None
    limits: LimitsSection = LimitsSection()
    joints: HeldJoints = Field(default_factory=dict)
    base: PoseSection = PoseSection(xyz_m=(0.0, 0.0, 0.0))
    home_deg: Configuration | None = None
    home_rad_or_m: Configuration | None = None
    parked: ParkedSection | None = None
    srdf: PathName | Literal[False] | None = None
    home: JointName | None = None
    ignore_contacts: Annotated[
        tuple[PairOf[JointName], ...], Field(max_length=MOST_ELEMENTS)
    ] = ()
    xacro: dict[JointName, str | int | float | bool] = Field(default_factory=dict)
    frames: dict[Name, PoseSection] = Field(default_factory=dict)
    repeatability_m: Annotated[float, Field(ge=0, le=0.1)] | None = None
    base_error: PoseErrorSection | None = None

    not_both = (("tool", "tools"), ("home_deg", "home_rad_or_m", "parked", "home"))

    @model_validator(mode="after")
    def _several_tools(self) -> RobotSection:
        if len(set(self.tools)) < len(self.tools) or len(self.tools) == 1:
            raise ValueError("tools are two or more, each named once")
        return self

    @property
    def outfits(self) -> tuple[RobotSection, ...]:
        """The robot with each of its tools as the only one; itself where it changes none."""
        if not self.tools:
            return (self,)
        return tuple(self.with_only(name) for name in self.tools)

    def with_only(self, tool: str | None) -> RobotSection:
        """Return the robot with one of its tools or none, without pairs of links of the others."""
        others = tuple(f"{name}." for name in self.tools if name != tool)
        kept = tuple(
            pair
            for pair in self.ignore_contacts
            if not any(link.startswith(others) for link in pair)
        )
        changes = {"tool": tool, "tools": (), "ignore_contacts": kept}
        return self.model_copy(update=changes)


class RingSection(Section):
    """Robots on a circle, evenly spread, facing its middle.

    Attributes:
        radius_m: of the circle.
        centre_m: its middle, x and y.
        start_deg: direction of the first robot, seen from the middle.
    """

    radius_m: Annotated[float, Field(ge=0.001, le=LARGEST_M)]
    centre_m: Vector2 = (0.0, 0.0)
    start_deg: Coordinate = 0.0


class TeamSection(Section):
    """Mobile robots of one type.

    Attributes:
        model: of all of them, as for a single robot.
        count: how many.
        name: of all of them; a number from 1 on follows it.
        ring: where they stand at HOME.
        tool: of all of them, as for a single robot.
        flange: likewise.
        limits: likewise.
        joints: likewise.
    """

    model: Annotated[str, Field(min_length=1, max_length=4096)]
    count: Annotated[int, Field(ge=1, le=MOST_OF_TEAM)]
    name: Name = "robot"
    ring: RingSection
    tool: Name | None = None
    flange: JointName | None = None
    limits: LimitsSection = LimitsSection()
    joints: HeldJoints = Field(default_factory=dict)

    def robots(self) -> tuple[RobotSection, ...]:
        """Return the robots one by one."""
        out = []
        alike = {key: getattr(self, key) for key in _OF_A_TEAM}
        for k in range(self.count):
            deg = self.ring.start_deg + 360.0 * k / self.count
            x, y = self.ring.centre_m
            x += self.ring.radius_m * math.cos(math.radians(deg))
            y += self.ring.radius_m * math.sin(math.radians(deg))
            # Facing the middle, written as an angle between -180 and 180 degrees.
            facing = (deg + 360.0) % 360.0 - 180.0
            parked = ParkedSection(
                at_m=(round(x, 6), round(y, 6)), facing_deg=round(facing, 6)
            )
            name = f"{self.name}{k + 1}"
            out.append(RobotSection(name=name, parked=parked, **alike))
        return tuple(out)


class FixtureSection(ShapedSection):
    """Something immovable.

    Attributes:
        name: unique among fixtures and objects.
        pose: of the frame of its shape in the world; of a box, its centre.
        frames: places on it where processes are done, by name: poses in the frame of its shape;
            their z axes point out of it.
        colour: red, green, blue, for pictures; default: a grey.
    """

    name: Name
    pose: PoseSection
    frames: dict[Name, PoseSection] = Field(default_factory=dict)
    colour: Colour | None = None


class ClearanceSection(Section):
    """Least distances kept.

    Attributes:
        robot_robot_m: between robots with all they carry.
        robot_object_m: between robots with all they carry and anything else.
        contact_tolerance_m: how deep a tool may graze a brick at rest within a LEGO skill; the
            default is the gap between neighbouring bricks, 0.1 mm on each side.
    """

    robot_robot_m: Annotated[float, Field(ge=0, le=1)] = Clearances.robot_robot
    robot_object_m: Annotated[float, Field(ge=0, le=1)] = Clearances.robot_object
    contact_tolerance_m: Annotated[float, Field(ge=0, le=0.002)] = (
        Clearances.contact_tolerance
    )


class CellSection(Section):
    """A cell: robots, fixtures and clearances.

    Attributes:
        tools: by name, what robots may carry.
        listed: ``robots`` of the file: robots given one by one.
        team: further robots, all of one type.
        fixtures: what does not move.
        clearance: least distances kept.
    """

    tools: dict[Name, ToolSection] = Field(default_factory=dict)
    listed: Annotated[
        tuple[RobotSection, ...],
        Field(alias="robots", max_length=MOST_ROBOTS - MOST_OF_TEAM),
    ] = ()
    team: TeamSection | None = None
    fixtures: tuple[FixtureSection, ...] = ()
    clearance: ClearanceSection = ClearanceSection()

    @model_validator(mode="after")
    def _check_robots_given(self) -> CellSection:
        if not self.listed and self.team is None:
            raise ValueError("key 'robots' is missing: a cell needs robots, or a team")
        return self

    @property
    def robots(self) -> tuple[RobotSection, ...]:
        """All robots: those given one by one, then the team."""
        return (*self.listed, *(() if self.team is None else self.team.robots()))


def choose_robots(cell: dict[str, Any], count: int) -> None:
    """Set the number of robots in the content of a cell section.

    A team gets that many robots, in addition to those listed; without a team, the first ``count``
    listed robots are kept.

    Args:
        cell: the section as a mapping with all defaults filled in, changed in place.
        count: how many.

    Raises:
        ScenarioError: there is no team, and there are fewer robots.
    """
    if cell["team"] is not None:
        cell["team"]["count"] = count
    elif count <= len(cell["robots"]):
        cell["robots"] = cell["robots"][:count]
    else:
        raise ScenarioError(
            f"--robots {count}: the cell has {len(cell['robots'])} robots and no team"
        )
