"""What the audit asks of a collision library: a world of shapes that are posed and measured."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations

import numpy as np

from planning.cell.shape import Box, Capsule, Cylinder, Mesh, Shape
from planning.cell.workcell import PlacedRobot, Workcell
from planning.robots.registry import ROBOTS
from planning.transforms import Array, Transform, translation
from twin.audit.worlds.link_chain import (
    Frames,
    JointAxes,
    LinkChain,
    ShapeLink,
    measured_chain,
    one_shape_a_link,
)

BASE = -1
"""In place of a joint's index: what the base of a robot carries."""


FAR = 10.0
"""Reach of measurements that look for whatever is nearest [m]."""


_WALL = 1.0
"""Edge of the wall to which the reach of tools is measured, and how far away it stands [m]."""


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


Convex = Box | Cylinder | Capsule | Array
"""A form, or the corners of a hull, shape (c, 3)."""


class AuditWorld(ABC):
    """The audit's own copy of a cell: robots from their URDF files, what else there is from its forms.

    A library loads, poses and measures bodies, which it knows by numbers.

    Args:
        cell: what to load.

    Attributes:
        cell: see there.
        robot_shapes: all shapes of all robots: convex primitives, and the hulls of meshes.
        fixtures, objects: at least one shape for each, in the order of the cell.
        limits: what the joints of each robot allow.
        axes: of the joints of each robot, in the order of the cell.

    Raises:
        RobotModelError: a description cannot be read, or has other joints.
    """

    margin = 0.0
    """That the library gives every shape of a URDF [m]."""

    def __init__(self, cell: Workcell) -> None:
        self.cell = cell
        self.robot_shapes: list[WatchedShape] = []
        self.limits: dict[str, JointLimits] = {}
        self.axes: list[JointAxes] = []
        self._chains: list[LinkChain | None] = []
        for index, robot in enumerate(cell.robots):
            self._add_robot(index, robot)
        self.fixtures = [
            item for f in cell.fixtures for item in self._thing(f.name, f.shape, f.pose)
        ]
        self.objects = [
            item for o in cell.objects for item in self._thing(o.name, o.shape, o.start)
        ]
        around = np.zeros(3), _WALL, np.full(3, 0.5 * _WALL), np.eye(3)
        number = self._body(Box((_WALL, _WALL, _WALL)))
        self._wall = WatchedShape("wall", "wall", number, None, BASE, *around)

    @abstractmethod
    def close(self) -> None:
        """Let go of what the library holds."""

    @abstractmethod
    def place(self, item: WatchedShape, pose: Transform) -> None:
        """Pose a shape of a fixture or an object; the pose may not change afterwards."""

    @abstractmethod
    def configure(self, robot: int, q: Array) -> None:
        """Put a robot at a configuration, shape (n,)."""

    @abstractmethod
    def distance(self, a: WatchedShape, b: WatchedShape, reach: float) -> float:
        """Return the signed distance of two shapes as they are placed now [m].

        Args:
            a, b: the shapes.
            reach: beyond this distance ``reach`` is returned.
        """

    @abstractmethod
    def _load(self, robot: PlacedRobot, text: str) -> tuple[JointAxes, JointLimits]:
        """Load a robot, the next one, from a description; velocities are those of it."""

    @abstractmethod
    def _link(
        self, robot: int, link: ShapeLink, entity: str, detail: str
    ) -> WatchedShape:
        """Return the shape of a link of a robot, of which entity and detail are known."""

    @abstractmethod
    def _body(self, form: Convex) -> int:
        """Load a form that is centred at the origin; return the number of its body."""

    @abstractmethod
    def _measured(self, robot: int, q: Array) -> Frames:
        """Return what ``link_frames`` does, by the library alone."""

    def link_frames(self, robot: int, q: Array) -> Frames:
        """Return where the base and the moved links of a robot are, as the library measured them.

        Args:
            robot: its index.
            q: configurations, shape (m, n).

        Returns:
            Rotations, shape (m, n + 1, 3, 3), and positions in the world, shape
            (m, n + 1, 3) [m]; entry 0 is the base, entry j + 1 the link that joint j moves.
        """
        chain = self._chains[robot]
        return self._measured(robot, q) if chain is None else chain.frames(q)

    def flange_poses(self, robot: int, q: Array) -> Array:
        """Return where a robot's flange is at configurations, shape (m, 4, 4)."""
        rotation, position = self.link_frames(robot, q)
        out = np.tile(np.eye(4), (len(q), 1, 1))
        out[:, :3, :3], out[:, :3, 3] = rotation[:, -1], position[:, -1]
        return np.asarray(out @ self.cell.robots[robot].model.flange)

    def reach(self, item: WatchedShape, origin: Array, way: Array) -> float:
        """Return how far a shape reaches along a direction from a point, as it is placed now [m].

        Measured to a wall in front of it that is larger than any tool.

        Args:
            item: the shape.
            origin: the point, in the world, shape (3,) [m].
            way: the direction, of length one, shape (3,).
        """
        aside = np.eye(3)[np.argmin(np.abs(way))]
        aside = np.cross(way, aside) / np.linalg.norm(np.cross(way, aside))
        pose = np.eye(4)
        pose[:3, :3] = np.column_stack([way, aside, np.cross(way, aside)])
        pose[:3, 3] = origin + 1.5 * _WALL * way
        self.place(self._wall, pose)
        return _WALL - self.distance(item, self._wall, FAR)

    def tool_shapes(self, robot: int) -> list[WatchedShape]:
        """Return the shapes of a robot's tool; of its outermost link, where it has none."""
        own = [shape for shape in self.robot_shapes if shape.robot == robot]
        tool = [shape for shape in own if shape.entity.endswith("/tool")]
        last = max(shape.joint for shape in own)
        return tool or [shape for shape in own if shape.joint == last]

    def _add_robot(self, index: int, robot: PlacedRobot) -> None:
        """Load a robot and note its shapes: what moves each, and a sphere around it."""
        model, base = robot.model, (robot.base[:3, :3], robot.base[:3, 3])
        text, links = one_shape_a_link(model.urdf, model.package_dirs, self.margin)
        axes, limits = self._load(robot, text)
        entry = ROBOTS.get(model.name)
        if entry and entry.velocity is not None:  # in place of what the URDF says
            limits = replace(limits, velocity=np.asarray(entry.velocity, dtype=float))
        self.axes.append(axes)
        self.limits[robot.name] = limits
        chain = measured_chain(axes, base, partial(self._measured, index))
        self._chains.append(chain)
        # pinocchio names shapes "<link>_<number>"; only the names are used here.
        parts = (part for part in model.parts if part.group == "tool")
        tool = {part.body.name.rsplit("_", 1)[0] for part in parts}
        for link in links:
            entity = f"{robot.name}/{'tool' if link.owner in tool else 'arm'}"
            detail = f"{robot.name}/{link.owner}"
            self.robot_shapes.append(self._link(index, link, entity, detail))

    def _thing(
        self, name: str, made_of: Shape, pose: Transform
    ) -> Iterator[WatchedShape]:
        """Yield the shapes of a fixture or an object, placed.

        They are its forms as they are, not planning's pieces. Only meshes are what planning cut
        them into: no library measures how deep two hollow things overlap. That their pieces
        contain them is checked where they are cut.
        """
        for form, local in _convex_forms(made_of):
            half, radius = _box_and_ball(form)
            around = np.zeros(3), radius, half, np.eye(3)
            number = self._body(form)
            item = WatchedShape(name, name, number, None, BASE, *around, local)
            self.place(item, item.at(pose))
            yield item


def _convex_forms(made_of: Shape) -> Iterator[tuple[Convex, Transform | None]]:
    """Yield convex forms, centred, and their poses in the shape, None for the same frame."""
    for element in made_of.elements:
        form, pose = element.form, element.pose
        if isinstance(form, Mesh):
            for hull in form.hulls:
                middle = 0.5 * (hull.min(axis=0) + hull.max(axis=0))
                there = pose @ translation(*middle.tolist())
                yield np.ascontiguousarray(hull - middle), there
        else:
            yield form, None if np.array_equal(pose, np.eye(4)) else pose


def _box_and_ball(form: Convex) -> tuple[Array, float]:
    """Return half edges of the box, shape (3,), and the radius of the sphere around a form [m]."""
    if isinstance(form, np.ndarray):
        half = np.abs(form).max(axis=0)
        return half, float(np.linalg.norm(form, axis=1).max())
    if isinstance(form, Box):
        half = 0.5 * np.asarray(form.size, dtype=float)
        return half, float(np.linalg.norm(half))
    high = 0.5 * form.length
    if isinstance(form, Capsule):
        high += form.radius
    radius = high if isinstance(form, Capsule) else float(np.hypot(form.radius, high))
    return np.array([form.radius, form.radius, high]), radius


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
