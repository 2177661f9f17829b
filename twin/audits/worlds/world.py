"""A copy of the cell, in which the audit places collision shapes and measures their distances."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import combinations, product
from typing import Any

import coal
import numpy as np
import pinocchio

from planning.cell.shape import Box, Capsule, Cylinder, Mesh, Shape
from planning.cell.workcell import Workcell
from planning.transforms import Array, Transform, translation
from scheduling.witness.parts import coal_pose, shape_distance
from scheduling.witness.robot import WitnessRobot
from scheduling.witness.shapes import hull_of, primitive_of

BASE = -1
"""Joint index of shapes on a robot's base."""


FAR = 10.0
"""Greatest distance in searches for the nearest shape [m]."""


_WALL = 1.0
"""Edge length and distance of the wall to which the extent of tools is measured [m]."""

Convex = Box | Cylinder | Capsule | Array
"""A form, or the corners of a hull, shape (c, 3)."""


@dataclass(frozen=True)
class WatchedShape:
    """One convex shape that the audit watches.

    Attributes:
        entity: the name allowed contacts use, which several shapes may share:
            ``"<robot>/arm"``, ``"<robot>/tool"``, a fixture or an object.
        detail: the link it belongs to, or the entity again.
        number: its index in the audit world.
        robot: index of its robot, None for fixtures and objects.
        joint: index of the joint that moves it, -1 for a robot's base.
        centre: of a sphere around it, in the frame of the link moved by ``joint`` (the origin
            for fixtures and objects), shape (3,) [m].
        radius: of that sphere [m].
        half: half edge lengths of a box around it with the same centre, shape (3,) [m].
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
        """Return its pose when its fixture or object is at ``pose``."""
        return pose if self.local is None else pose @ self.local


class AuditWorld:
    """Shapes that are posed and measured pairwise.

    Robots have the shapes of ``scheduling.witness``; fixtures and objects those of the cell.

    Args:
        cell: the cell.

    Attributes:
        cell: the cell.
        robots: of the cell, read from their URDF files.
        robot_shapes: all shapes of all robots: convex primitives, and the hulls of meshes.
        fixtures, objects: at least one shape for each, in the order of the cell.
        limits: joint limits of each robot.

    Raises:
        RobotModelError: a description cannot be read, or has other joints.
    """

    def __init__(self, cell: Workcell) -> None:
        self.cell = cell
        self.robots = [WitnessRobot(robot) for robot in cell.robots]
        self.limits = {
            placed.name: robot.limits
            for placed, robot in zip(cell.robots, self.robots, strict=True)
        }
        # Shapes and poses of coal by number; None for shapes of robots whose poses are computed later.
        self._geometries: list[Any] = []
        self._poses: list[Any] = []
        self.robot_shapes = [
            shape for k in range(len(self.robots)) for shape in self._arm(k)
        ]
        parts = [part for robot in self.robots for part in robot.parts]
        self._locals = [pinocchio.SE3(part.local) for part in parts]
        self._own: list[list[int]] = [[] for _ in self.robots]
        for shape in self.robot_shapes:
            assert shape.robot is not None
            self._own[shape.robot].append(shape.number)
        self._q = [robot.home for robot in cell.robots]
        self._frames: list[list[Any] | None] = [None] * len(self.robots)
        self.fixtures = [
            item
            for f in cell.fixtures
            for item in self._shapes_of(f.name, f.shape, f.pose)
        ]
        self.objects = [
            item
            for o in cell.objects
            for item in self._shapes_of(o.name, o.shape, o.start)
        ]
        around = np.zeros(3), _WALL, np.full(3, 0.5 * _WALL), np.eye(3)
        number = self._add(coal.Box(_WALL, _WALL, _WALL))
        self._wall = WatchedShape("wall", "wall", number, None, BASE, *around)

    def place(self, item: WatchedShape, pose: Transform) -> None:
        """Pose a shape of a fixture or an object."""
        self._poses[item.number] = coal_pose(pose)

    def configure(self, robot: int, q: Array) -> None:
        """Put a robot at a configuration, shape (n,)."""
        self._q[robot], self._frames[robot] = q, None
        for number in self._own[robot]:
            self._poses[number] = None

    def distance(self, a: WatchedShape, b: WatchedShape, reach: float) -> float:
        """Return the signed distance of two shapes as they are placed now [m].

        Args:
            a, b: the shapes.
            reach: beyond this distance ``reach`` is returned.
        """
        i, j = a.number, b.number
        found = shape_distance(
            self._geometries[i], self._pose(a), self._geometries[j], self._pose(b)
        )
        return min(found, reach)

    def link_frames(self, robot: int, q: Array) -> tuple[Array, Array]:
        """Return the poses of a robot's base and moved links.

        Args:
            robot: its index.
            q: configurations, shape (m, n).

        Returns:
            Rotations, shape (m, n + 1, 3, 3), and positions in the world, shape
            (m, n + 1, 3) [m]; entry 0 is the base, entry j + 1 the link that joint j moves.
        """
        frames = self.robots[robot].joint_frames_along(q)
        return frames[..., :3, :3], frames[..., :3, 3]

    def flange_poses(self, robot: int, q: Array) -> Array:
        """Return flange poses at configurations, shape (m, 4, 4)."""
        own = self.robots[robot]
        return np.asarray(own.joint_frames_along(q)[:, -1] @ own.flange)

    def reach(self, item: WatchedShape, origin: Array, direction: Array) -> float:
        """Return the extent of a placed shape along a direction from a point [m].

        Measured to a wall in front of it that is larger than any tool.

        Args:
            item: the shape.
            origin: the point, in the world, shape (3,) [m].
            direction: unit direction, shape (3,).
        """
        normal = np.eye(3)[np.argmin(np.abs(direction))]
        normal = np.cross(direction, normal) / np.linalg.norm(
            np.cross(direction, normal)
        )
        pose = np.eye(4)
        pose[:3, :3] = np.column_stack([direction, normal, np.cross(direction, normal)])
        pose[:3, 3] = origin + 1.5 * _WALL * direction
        self.place(self._wall, pose)
        return _WALL - self.distance(item, self._wall, FAR)

    def tool_shapes(self, robot: int) -> list[WatchedShape]:
        """Return the shapes of a robot's tool; of its outermost link, where it has none."""
        own = [shape for shape in self.robot_shapes if shape.robot == robot]
        tool = [shape for shape in own if shape.entity.endswith("/tool")]
        last = max(shape.joint for shape in own)
        return tool or [shape for shape in own if shape.joint == last]

    def _arm(self, index: int) -> Iterator[WatchedShape]:
        """Yield the shapes of a robot with their links and bounding spheres."""
        robot, name = self.robots[index], self.cell.robots[index].name
        for part, link in zip(robot.parts, robot.links, strict=True):
            box = part.shape.aabb_local
            half, turn = 0.5 * np.asarray(box.max_ - box.min_), part.local[:3, :3]
            around = part.centre, part.radius, half, turn
            number, detail = self._add(part.shape), f"{name}/{link}"
            yield WatchedShape(part.entity, detail, number, index, part.joint, *around)

    def _add(self, geometry: Any) -> int:
        """Add a coal shape; return its number."""
        self._geometries.append(geometry)
        self._poses.append(None)
        return len(self._poses) - 1

    def _pose(self, item: WatchedShape) -> Any:
        pose = self._poses[item.number]
        if pose is None:
            assert item.robot is not None
            frames = self._frames[item.robot]
            if frames is None:
                frames = self.robots[item.robot].joint_placements(self._q[item.robot])
                self._frames[item.robot] = frames
            pose = frames[item.joint + 1] * self._locals[item.number]
            self._poses[item.number] = pose
        return pose

    def _shapes_of(
        self, name: str, made_of: Shape, pose: Transform
    ) -> Iterator[WatchedShape]:
        """Yield the shapes of a fixture or an object, placed.

        Primitives are exact, not the pieces that planning uses. Meshes are represented by the convex pieces of
        planning, since no library measures the depth of an overlap of two concave bodies. Whether these pieces
        contain the mesh is checked when they are made.
        """
        for form, local in convex_forms(made_of):
            half, radius = _bounding_box_and_sphere(form)
            around = np.zeros(3), radius, half, np.eye(3)
            number = self._add(_geometry(form))
            item = WatchedShape(name, name, number, None, BASE, *around, local)
            self.place(item, item.at(pose))
            yield item


def convex_forms(made_of: Shape) -> Iterator[tuple[Convex, Transform | None]]:
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


def _bounding_box_and_sphere(form: Convex) -> tuple[Array, float]:
    """Return half edge lengths of the bounding box, shape (3,), and the radius of the bounding sphere [m]."""
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


def _geometry(form: Convex) -> Any:
    """Return the coal geometry of a form."""
    if isinstance(form, np.ndarray):
        return hull_of(form)
    return primitive_of(form)


def shapes_by_entity(shapes: Iterable[WatchedShape]) -> dict[str, list[WatchedShape]]:
    """Return the shapes of each fixture or object by its name, in their order."""
    out: dict[str, list[WatchedShape]] = {}
    for item in shapes:
        out.setdefault(item.entity, []).append(item)
    return out


def overlapping_at_home(world: AuditWorld) -> frozenset[tuple[int, int]]:
    """Return pairs of a robot's own shapes, by their numbers, that are not checked.

    Shapes of one link or of neighbouring links touch by design. HOME is free of collisions, so shapes that overlap
    there do so only because hulls are larger than their contents. Fixtures that a robot is mounted on are links
    before its first joint. Pairs of links that the description exempts are not checked either.
    """
    for index, robot in enumerate(world.cell.robots):
        world.configure(index, robot.home)
    out, first = set[tuple[int, int]](), 0
    for own in world.robots:
        out |= {(first + i, first + j) for i, j in own.ignored}
        first += len(own.parts)
    for (i, a), (j, b) in combinations(enumerate(world.robot_shapes), 2):
        if a.robot == b.robot:
            touching = abs(a.joint - b.joint) <= 1
            if touching or world.distance(a, b, 1.0) <= 0.0:
                out.add((i, j))
    for a, b in product(world.robot_shapes, world.fixtures):
        assert a.robot is not None
        mounted = {item.name for item in world.cell.robots[a.robot].mounted_on}
        bolted = b.entity in mounted
        if bolted and (a.joint <= 0 or world.distance(a, b, 1.0) <= 0.0):
            out.add((a.number, b.number))
    return frozenset(out)
