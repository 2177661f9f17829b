"""What the audit asks of a collision library: a world of shapes that are posed and measured."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Protocol

import numpy as np
import numpy.typing as npt

from planning.cell.workcell import Workcell
from planning.transforms import Array, Transform

BASE = -1
"""In place of a joint's index: what the base of a robot carries."""


FAR = 10.0
"""Reach of measurements that look for whatever is nearest [m]."""


@dataclass(frozen=True)
class Shape:
    """One convex shape that the audit watches.

    Attributes:
        entity: the name allowed contacts use, which several shapes may share:
            ``"<robot>/arm"``, ``"<robot>/tool"``, a fixture or an object.
        detail: the link it belongs to, or the entity again.
        number: what its world knows it by.
        robot: index of its robot, None for fixtures and objects.
        joint: index of the joint that moves it, -1 for a robot's base.
        centre: of a sphere around it, in the frame of the link moved by ``joint`` (the origin
            for fixtures and objects), shape (3,) [m].
        radius: of that sphere [m].
        half: half edges of a box around it with the same centre, shape (3,) [m].
        turn: rotation of that box, in the same frame, shape (3, 3).
        local: pose of its frame in that of the fixture or object, where they are not the same.
    """

    entity: str
    detail: str
    number: int
    robot: int | None
    joint: int
    centre: Array
    radius: float
    half: Array
    turn: Array
    local: Transform | None = None

    def at(self, pose: Transform) -> Transform:
        """Return its pose where the fixture or object that it belongs to is at ``pose``."""
        return pose if self.local is None else pose @ self.local


@dataclass(frozen=True)
class JointLimits:
    """Limits of a robot's joints, from its URDF.

    Attributes:
        names: of the joints.
        lower, upper: shape (n,); infinite for joints without limits [rad or m].
        velocity: shape (n,) [rad/s or m/s].
        units: ``"rad"`` or ``"m"`` of each joint.
    """

    names: tuple[str, ...]
    lower: Array
    upper: Array
    velocity: Array
    units: tuple[str, ...]


@dataclass(frozen=True)
class JointAxes:
    """The axes of a robot's joints.

    Attributes:
        direction: in the frame of the link that the joint moves, shape (n, 3).
        prismatic: shape (n,).
    """

    direction: Array
    prismatic: npt.NDArray[np.bool_]


class AuditWorld(Protocol):
    """The audit's own copy of a cell: robots from their URDF files, what else there is from its forms."""

    @property
    def cell(self) -> Workcell:
        """What was loaded."""

    @property
    def robot_shapes(self) -> Sequence[Shape]:
        """All shapes of all robots: convex primitives, and the hulls of meshes."""

    @property
    def fixtures(self) -> Sequence[Shape]:
        """At least one shape a fixture, in the order of the cell."""

    @property
    def objects(self) -> Sequence[Shape]:
        """At least one shape an object, in the order of the cell."""

    @property
    def limits(self) -> Mapping[str, JointLimits]:
        """What the joints of each robot allow."""

    @property
    def axes(self) -> Sequence[JointAxes]:
        """Axes of the joints of each robot, in the order of the cell."""

    def close(self) -> None:
        """Let go of what the library holds."""

    def place(self, item: Shape, pose: Transform) -> None:
        """Pose a shape of a fixture or an object; the pose may not change afterwards."""

    def configure(self, robot: int, q: Array) -> None:
        """Put a robot at a configuration, shape (n,)."""

    def link_frames(self, robot: int, q: Array) -> tuple[Array, Array]:
        """Return where the base and the moved links of a robot are.

        Args:
            robot: its index.
            q: configurations, shape (m, n).

        Returns:
            Rotations, shape (m, n + 1, 3, 3), and positions in the world, shape
            (m, n + 1, 3) [m]; entry 0 is the base, entry j + 1 the link that joint j moves.
        """

    def distance(self, a: Shape, b: Shape, reach: float) -> float:
        """Return the signed distance of two shapes as they are placed now [m].

        Args:
            a, b: the shapes.
            reach: beyond this distance ``reach`` is returned.
        """


def shapes_by_entity(shapes: Iterable[Shape]) -> dict[str, list[Shape]]:
    """Return the shapes of each fixture or object by its name, in their order."""
    out: dict[str, list[Shape]] = {}
    for item in shapes:
        out.setdefault(item.entity, []).append(item)
    return out


def overlapping_at_home(world: AuditWorld) -> frozenset[tuple[int, int]]:
    """Return pairs of a robot's own shapes (indices of ``robot_shapes``) that are not checked.

    Shapes of one link or of neighbouring links touch by design. Shapes that overlap at HOME,
    which is free of collisions, only do so because hulls are larger than what they contain.
    """
    for index, robot in enumerate(world.cell.robots):
        world.configure(index, robot.home)
    out = set()
    for (i, a), (j, b) in combinations(enumerate(world.robot_shapes), 2):
        if a.robot == b.robot:
            touching = abs(a.joint - b.joint) <= 1
            if touching or world.distance(a, b, 1.0) <= 0.0:
                out.add((i, j))
    return frozenset(out)
