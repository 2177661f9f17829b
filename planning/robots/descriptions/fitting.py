"""What a cell adds to the description of a robot: a tool, a flange, limits, joints that are held."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from planning.cell.robot_model import ToolGrip
from planning.cell.shape import Element
from planning.transforms import Transform, identity


@dataclass(frozen=True, kw_only=True)
class Tool:
    """A tool of a cell, apart from any robot.

    Attributes:
        name: unique in the cell.
        description: its URDF or MJCF file; None for a tool of shapes.
        shapes: what a tool without a description is made of, in the frame of its one link.
        within: how deep a hollow of the meshes of its description may be that convex pieces fill;
            None for one hull a mesh [m].
        held: its joints and the values they are held at, those left out at zero [rad or m].
        mount: pose of its root link in the flange frame of a robot.
        tcp: pose of the point at which it works in the frame of its root link, z out of the
            hand; None for the link that is named as such.
        closing: axis of that frame along which fingers close.
        frames: further frames, each a pose in the frame of the root link.
        grip: how it holds; None for tools that hold nothing.
    """

    name: str
    description: Path | None = None
    shapes: tuple[Element, ...] = ()
    within: float | None = None
    held: Mapping[str, float] = field(default_factory=dict)
    mount: Transform = field(default_factory=identity)
    tcp: Transform | None = None
    closing: Literal["x", "y"] = "y"
    frames: Mapping[str, Transform] = field(default_factory=dict)
    grip: ToolGrip | None = None


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Limits of a robot's joints in place of what its description says.

    Attributes:
        velocity: one value for all joints, or one for each [rad/s or m/s].
        acceleration: likewise [rad/s^2 or m/s^2].
        jerk: likewise [rad/s^3 or m/s^3].
        effort: likewise [N m or N].
        payload: the most that it may carry, its tool included [kg].
    """

    velocity: tuple[float, ...] | None = None
    acceleration: tuple[float, ...] | None = None
    jerk: tuple[float, ...] | None = None
    effort: tuple[float, ...] | None = None
    payload: float | None = None

    def by_joint(self) -> Mapping[str, tuple[float, ...]]:
        """Return the limits that are given of joints, by the names that URDF has for them."""
        keys = ("velocity", "acceleration", "jerk", "effort")
        given = {key: getattr(self, key) for key in keys}
        return {key: values for key, values in given.items() if values is not None}


@dataclass(frozen=True, kw_only=True)
class Fitting:
    """Changes that a cell makes to the description of a robot.

    Attributes:
        tool: what is mounted on its flange; None for what it comes with.
        bare: whether nothing is mounted, not even what it comes with: its tools are handled as
            objects, and what hangs on its last joint touches them.
        flange: link whose frame is the flange; None for the one that its description means.
        held: joints of the description that are held, and at what [rad or m].
        limits: of its joints.
    """

    tool: Tool | None = None
    bare: bool = False
    flange: str | None = None
    held: Mapping[str, float] = field(default_factory=dict)
    limits: Limits = Limits()

    @property
    def is_nothing(self) -> bool:
        """Whether the description stays as it is."""
        return (
            self.tool is None
            and not self.bare
            and self.flange is None
            and not self.held
            and self.limits == Limits()
        )
