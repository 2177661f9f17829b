"""What the audit asks of a collision library: a world of shapes that are posed and measured.

Which collision library the audit measures with: PyBullet where it is installed, else coal.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from itertools import combinations
from typing import Literal, Protocol

import numpy as np
import numpy.typing as npt

from planning.cell.workcell import Workcell
from planning.errors import RequestError
from planning.transforms import Array, Transform

BASE = -1
"""In place of a joint's index: what the base of a robot carries."""


FAR = 10.0
"""Reach of measurements that look for whatever is nearest [m]."""


@dataclass(frozen=True)
class WatchedShape:
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
    def robot_shapes(self) -> Sequence[WatchedShape]:
        """All shapes of all robots: convex primitives, and the hulls of meshes."""

    @property
    def fixtures(self) -> Sequence[WatchedShape]:
        """At least one shape a fixture, in the order of the cell."""

    @property
    def objects(self) -> Sequence[WatchedShape]:
        """At least one shape an object, in the order of the cell."""

    @property
    def limits(self) -> Mapping[str, JointLimits]:
        """What the joints of each robot allow."""

    @property
    def axes(self) -> Sequence[JointAxes]:
        """Axes of the joints of each robot, in the order of the cell."""

    def close(self) -> None:
        """Let go of what the library holds."""

    def place(self, item: WatchedShape, pose: Transform) -> None:
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

    def distance(self, a: WatchedShape, b: WatchedShape, reach: float) -> float:
        """Return the signed distance of two shapes as they are placed now [m].

        Args:
            a, b: the shapes.
            reach: beyond this distance ``reach`` is returned.
        """


def shapes_by_entity(shapes: Iterable[WatchedShape]) -> dict[str, list[WatchedShape]]:
    """Return the shapes of each fixture or object by its name, in their order."""
    out: dict[str, list[WatchedShape]] = {}
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


Engine = Literal["pybullet", "coal"]

ENGINES: tuple[Engine, ...] = ("pybullet", "coal")
"""Libraries the audit can measure with, the stronger witness first."""

INSTALL = "pip install 'assembly-twin[audit]'" + (
    "" if sys.version_info < (3, 12) else " (compiles it, with a C++ compiler)"
)
"""What installs PyBullet: there are ready-made packages for Python 3.11 only."""


def engine_named(name: str | None) -> Engine:
    """Return the engine of a name; without one PyBullet where it is installed, else coal.

    Raises:
        RequestError: there is no such engine, or it is not installed.
    """
    if name is None:
        return "pybullet" if _loads_pybullet() is None else "coal"
    if name not in ENGINES:
        raise RequestError(f"audit: there is no engine {name!r}", choices=ENGINES)
    if name == "pybullet" and (why := _loads_pybullet()) is not None:
        raise RequestError(
            f"audit: PyBullet does not load ({why}); choose the engine coal, or {INSTALL}"
        )
    return name


def _loads_pybullet() -> str | None:
    """Return why PyBullet cannot be used, None where it can."""
    try:
        import twin.audit.worlds.bullet_world  # noqa: F401
    except Exception as error:  # a broken library may raise anything
        return f"{type(error).__name__}: {error}"
    return None


@cache
def engine_and_version(engine: Engine) -> str:
    """Return an engine as reports name it: ``"coal 3.0.3"``."""
    try:
        return f"{engine} {version(engine)}"
    except PackageNotFoundError:  # compiled into its place by hand
        return engine


def open_world(cell: Workcell, engine: Engine | None = None) -> AuditWorld:
    """Return a cell loaded into an engine; close it after use.

    Args:
        cell: what to load: URDF files of robots, boxes for the rest.
        engine: by default PyBullet where it is installed, else coal.

    Raises:
        RequestError: the engine is not installed.
        RobotModelError: a description cannot be read.
    """
    if engine_named(engine) == "pybullet":
        from twin.audit.worlds.bullet_world import BulletWorld

        return BulletWorld(cell)
    from twin.audit.worlds.coal_world import CoalWorld

    return CoalWorld(cell)
