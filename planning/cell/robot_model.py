"""Model of a robot type for planning: a serial chain of joints with convex bodies."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from planning.cell.body import ConvexBody
from planning.errors import RobotModelError
from planning.transforms import Array, Transform, identity


@dataclass(frozen=True)
class KinematicChain:
    """Serial chain: joints in order from the base; each one moves all later ones.

    Attributes:
        placement: pose of each joint's frame in the frame of the joint before it (the base
            for the first) at zero, shape (n, 4, 4).
        axis: unit joint axes in their joint's frame, shape (n, 3).
        prismatic: True where the joint slides, shape (n,).
    """

    placement: Array
    axis: Array
    prismatic: npt.NDArray[np.bool_]


@dataclass(frozen=True)
class LinkPart:
    """One convex body of a robot.

    Attributes:
        joint: index of the joint that moves it, -1 for the base.
        group: ``"arm"`` or ``"tool"``: what allowed contacts speak of.
        body: the hull and its capsules, in the joint's frame (the base frame for -1).
    """

    joint: int
    group: str
    body: ConvexBody

    @property
    def link(self) -> str:
        """Name of its link in the description."""
        return self.body.name.rpartition("_")[0]


@dataclass(frozen=True)
class ToolGrip:
    """How a tool grips: between fingers, or by suction.

    Attributes:
        opening: least and largest distance of the fingers, along the y axis of the tool frame;
            None for suction [m].
        tool: name of the tool, for messages.
        force: closing force of either finger; None where not stated [N].
    """

    opening: tuple[float, float] | None = None
    tool: str = "tool"
    force: float | None = None

    @property
    def suction(self) -> bool:
        """Whether it holds by suction."""
        return self.opening is None


@dataclass(frozen=True, eq=False)
class DriveLimits:
    """Limits of a robot's drives besides their speed; infinite where nothing is known.

    Attributes:
        acceleration: of each joint, shape (n,) [rad/s^2 or m/s^2].
        jerk: of each joint, shape (n,) [rad/s^3 or m/s^3].
        effort: of each joint, shape (n,) [N m or N].
        payload: the most that the robot may carry, its tool included [kg].
        tool_mass: mass of its tool, as far as the description states it [kg].
    """

    acceleration: Array
    jerk: Array
    effort: Array
    payload: float = math.inf
    tool_mass: float = 0.0

    @property
    def spare(self) -> float:
        """Remaining payload in addition to the tool [kg]."""
        return max(0.0, self.payload - self.tool_mass)


@dataclass(frozen=True, eq=False)
class LinkInertias:
    """Masses that the joints of a robot move, one entry a joint, in the frame of the joint.

    Attributes:
        mass: of all that hangs on the joint up to the next one, shape (n,) [kg].
        centre: its centre of mass, shape (n, 3) [m].
        inertia: its rotational inertia about that, shape (n, 3, 3) [kg m^2].
    """

    mass: Array
    centre: Array
    inertia: Array


@dataclass(frozen=True, eq=False)
class RobotModel:
    """A robot type, free of any placement in a cell.

    Attributes:
        name: name in the registry, or the file's stem.
        urdf: the description it was read from.
        package_dirs: where ``package://`` paths of the description are looked up.
        joint_names: the n moved joints, base to tip.
        lower, upper: joint limits, shape (n,) [rad or m].
        velocity: joint speed limits, shape (n,) [rad/s or m/s].
        chain: the kinematics.
        flange: pose of the flange in the last joint's frame.
        frames: named tool frames, each a pose in the flange frame.
        parts: everything that can be touched.
        never_collide: pairs of part indices (low, high) exempt from self-collision: the same
            joint, neighbours in the chain, pairs that no configuration brings together, or
            pairs of links in ``ignored_contacts``.
        home: a collision-free configuration, shape (n,).
        flange_link: the link of the description whose frame the flange is.
        grip: how its tool holds; None where the description does not tell.
        drives: limits of its drives; None where unknown.
        inertias: of its links and its tool, from its description; None where unknown.
        ignored_contacts: pairs of links, by name, that its maker or the cell exempts from
            self-collision checks.
    """

    name: str
    urdf: Path
    package_dirs: tuple[Path, ...]
    joint_names: tuple[str, ...]
    lower: Array
    upper: Array
    velocity: Array
    chain: KinematicChain
    flange: Transform
    frames: Mapping[str, Transform]
    parts: tuple[LinkPart, ...]
    never_collide: frozenset[tuple[int, int]]
    home: Array
    flange_link: str = ""
    grip: ToolGrip | None = None
    drives: DriveLimits | None = None
    inertias: LinkInertias | None = None
    ignored_contacts: frozenset[tuple[str, str]] = frozenset()

    @property
    def dof(self) -> int:
        """Number of moved joints."""
        return len(self.joint_names)

    @property
    def is_mobile(self) -> bool:
        """Whether it drives: its first joints slide along x and y and turn about z."""
        axis, prismatic = self.chain.axis[:3], self.chain.prismatic[:3]
        return (
            self.dof > 3
            and tuple(prismatic) == (True, True, False)
            and bool(np.allclose(axis, np.eye(3)))
            and bool(np.allclose(self.chain.placement[:3], np.eye(4)))
        )

    def frame_in_last_joint(self, frame: str) -> Transform:
        """Return the pose of the flange or of a tool frame in the last joint's frame.

        Raises:
            RobotModelError: the robot has no such frame.
        """
        if frame == "flange":
            return self.flange
        return np.asarray(self.flange @ self.frame_in_flange(frame))

    def frame_in_flange(self, frame: str) -> Transform:
        """Return the pose of the flange or of a tool frame in the flange's frame.

        Raises:
            RobotModelError: the robot has no such frame.
        """
        if frame == "flange":
            return identity()
        if frame not in self.frames:
            raise RobotModelError(
                f"robot {self.name!r} has no frame {frame!r}",
                choices=("flange", *self.frames),
            )
        return self.frames[frame]
