"""Tools of a scenario, apart from the robots that carry them, and limits of joints."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from planning.cell.robot_model import ToolGrip
from twin.durations import AnyDuration, Fixed
from twin.scenario.document.section import Name, Section, Several
from twin.scenario.sections.poses import Coordinate, PoseSection
from twin.scenario.sections.shapes import Length, PlacedShapeSection

Opening = Annotated[float, Field(ge=0, le=10)]
JointName = Annotated[str, Field(min_length=1, max_length=256)]
HeldJoints = dict[JointName, Coordinate]

_Limit = Annotated[float, Field(gt=0, le=1e6)]
_ToolSpeed = Annotated[float, Field(ge=0.001, le=1000)]


class RackSection(PoseSection):
    """Place of a tool in its rack, and how a robot takes it from there.

    Attributes:
        approach_m: straight way of the robot along its flange's axis into the rack, and out of it.
        change_s: time that it takes to lock the tool on the flange, and to let go of it.
        change: distribution of that time, in place of ``change_s``.
    """

    approach_m: Annotated[float, Field(ge=0.001, le=1)] = 0.1
    change_s: Annotated[float, Field(ge=0, le=1e6)] = 2.0
    change: AnyDuration | None = None

    @model_validator(mode="after")
    def _one_time(self) -> RackSection:
        if self.change is not None and "change_s" in self.model_fields_set:
            raise ValueError("give change_s or change, not both")
        return self

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
    frames: dict[Name, PoseSection] = Field(default_factory=dict)
    rack: RackSection | None = None

    @model_validator(mode="after")
    def _something(self) -> ToolSection:
        if (self.description is None) == (not self.shapes):
            raise ValueError("give description or shapes, one of them")
        if self.description is None and (self.joints or self.within_m is not None):
            raise ValueError("joints and within_m belong to a description")
        return self

    @model_validator(mode="after")
    def _one_way_to_hold(self) -> ToolSection:
        if self.suction and self.opening_m is not None:
            raise ValueError("give opening_m or suction, not both")
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
        return ToolGrip(opening, name) if self.suction or opening is not None else None


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
    effort: Several[_Limit] | _Limit | None = None
    payload_kg: Annotated[float, Field(gt=0, le=1e6)] | None = None
    tool_speed_m_s: _ToolSpeed | None = None
    loaded_tool_speed_m_s: _ToolSpeed | None = None
