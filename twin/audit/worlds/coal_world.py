"""The audit's own copy of the cell in coal, for where PyBullet is not installed.

The planner measures with coal too, but not this way: here pinocchio reads the URDF files and
poses the robots, primitives stay what they are, and nothing is decided before it is measured.
PyBullet is the stronger witness all the same: it shares no library with the planner.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import coal
import numpy as np
import pinocchio

from planning.cell.shape import Box, Capsule, Cylinder, Shape
from planning.cell.workcell import PlacedRobot, Workcell
from planning.errors import RobotModelError
from planning.robots.registry import ROBOTS
from planning.transforms import Array, Transform
from twin.audit.worlds.exact_urdf import (
    Convex,
    measured_chain,
    one_shape_a_link,
    solids,
)
from twin.audit.worlds.world import BASE, JointAxes, JointLimits, WatchedShape


@dataclass
class _Body:
    """A body in coal's world.

    Attributes:
        geometry: coal's shape.
        pose: coal's pose of it in the world; None until its robot's is needed.
        item: number of a robot's shape in its geometry, None for boxes.
    """

    geometry: Any
    pose: Any = None
    item: int | None = None


class CoalWorld:
    """Shapes that are posed and measured two by two, with nothing in between.

    Args:
        cell: what to load.
    """

    def __init__(self, cell: Workcell) -> None:
        self.cell = cell
        self._request, self._result = coal.DistanceRequest(), coal.DistanceResult()
        self._bodies: list[_Body] = []
        self._arms = [_Arm(robot) for robot in cell.robots]
        self.robot_shapes: list[WatchedShape] = []
        for index, arm in enumerate(self._arms):
            first = len(self._bodies)
            self._bodies += arm.bodies
            self.robot_shapes += arm.shapes(index, first)
        self.limits = {arm.name: arm.limits() for arm in self._arms}
        self.axes = [arm.axes() for arm in self._arms]
        self.fixtures = [
            item for f in cell.fixtures for item in self._thing(f.name, f.shape, f.pose)
        ]
        self.objects = [
            item for o in cell.objects for item in self._thing(o.name, o.shape, o.start)
        ]

    def close(self) -> None:
        """Do nothing: coal holds nothing that is not freed by itself."""

    def _thing(
        self, name: str, made_of: Shape, pose: Transform
    ) -> Iterator[WatchedShape]:
        """Yield the shapes of a fixture or an object, placed."""
        for solid in solids(made_of):
            self._bodies.append(_Body(_geometry(solid.form)))
            item = solid.shape(name, len(self._bodies) - 1)
            self.place(item, item.at(pose))
            yield item

    def place(self, item: WatchedShape, pose: Transform) -> None:
        """Pose a shape of a fixture or an object."""
        self._bodies[item.number].pose = coal.Transform3s(pose[:3, :3], pose[:3, 3])

    def configure(self, robot: int, q: Array) -> None:
        """Put a robot at a configuration, shape (n,)."""
        self._arms[robot].configure(q)

    def link_frames(self, robot: int, q: Array) -> tuple[Array, Array]:
        """Return where pinocchio puts the base and the moved links of a robot."""
        return self._arms[robot].link_frames(q)

    def distance(self, a: WatchedShape, b: WatchedShape, reach: float) -> float:
        """Return the signed distance of two shapes as they are placed now [m]."""
        first, second = self._bodies[a.number], self._bodies[b.number]
        for shape, body in ((a, first), (b, second)):
            if body.pose is None:
                assert shape.robot is not None
                self._arms[shape.robot].pose(body)
        self._result.clear()
        found = coal.distance(
            first.geometry,
            first.pose,
            second.geometry,
            second.pose,
            self._request,
            self._result,
        )
        return min(float(found), reach)


class _Arm:
    """A robot that pinocchio poses.

    Args:
        placed: which one; names, files, and the poses of its base and HOME are used.
    """

    def __init__(self, placed: PlacedRobot) -> None:
        model = placed.model
        self.name, self._base = placed.name, pinocchio.SE3(placed.base)
        text, links = one_shape_a_link(model.urdf, model.package_dirs, 0.0)
        try:
            self._model = pinocchio.buildModelFromXML(text)
            self._geometry = pinocchio.buildGeomFromUrdfString(
                self._model, text, pinocchio.GeometryType.COLLISION
            )
        except (ValueError, RuntimeError) as error:
            raise RobotModelError(f"cannot read {model.urdf}: {error}") from error
        names = list(self._model.names)
        missing = [name for name in model.joint_names if name not in names]
        if missing:
            raise RobotModelError(
                f"{model.urdf} has no joint {missing[0]!r}", choices=tuple(names[1:])
            )
        self._moved = [names.index(name) for name in model.joint_names]
        self._joints = [self._model.joints[number] for number in self._moved]
        self._data = self._model.createData()
        self._poses = self._geometry.createData()
        self._state = pinocchio.neutral(self._model)
        self._entry = ROBOTS.get(model.name)
        for name, value in (self._entry.frozen if self._entry else {}).items():
            self._state[self._model.joints[names.index(name)].idx_q] = value
        # pinocchio names shapes "<link>_<number>"; only the names are used here.
        self._tool = {
            part.body.name.rsplit("_", 1)[0]
            for part in model.parts
            if part.group == "tool"
        }
        items = {
            self._model.frames[item.parentFrame].name: (k, item)
            for k, item in enumerate(self._geometry.geometryObjects)
        }
        # In the order of the file, as pinocchio's is another one.
        self._items = [(link.owner, *items[link.link]) for link in links]
        self.bodies = [
            _Body(_convex(item.geometry), item=k) for _, k, item in self._items
        ]
        self._current = False
        self._chain = measured_chain(
            self.axes(), (placed.base[:3, :3], placed.base[:3, 3]), self._measured
        )
        self.configure(placed.home)

    def shapes(self, robot: int, first: int) -> Iterator[WatchedShape]:
        """Yield its shapes: what moves each, and a sphere around it.

        Args:
            robot: its index.
            first: number of its first body.
        """
        self._update()
        for number, (owner, k, item) in enumerate(self._items):
            carrier = item.parentJoint
            while carrier and carrier not in self._moved:
                carrier = self._model.parents[carrier]
            body = self.bodies[number].geometry
            body.computeLocalAABB()
            pose = self._data.oMi[carrier].inverse() * self._poses.oMg[k]
            centre = np.asarray(pose.act(np.asarray(body.aabb_center)))
            yield WatchedShape(
                f"{self.name}/{'tool' if owner in self._tool else 'arm'}",
                f"{self.name}/{owner}",
                first + number,
                robot,
                self._moved.index(carrier) if carrier else BASE,
                centre,
                float(body.aabb_radius),
                0.5 * np.asarray(body.aabb_local.max_ - body.aabb_local.min_),
                np.asarray(pose.rotation),
            )

    def limits(self) -> JointLimits:
        """Return the limits that the URDF gives the joints, or the registry in its place."""
        first = [joint.idx_q for joint in self._joints]
        free = np.array([joint.nq > joint.nv for joint in self._joints])
        speed = self._model.velocityLimit[[joint.idx_v for joint in self._joints]]
        if self._entry and self._entry.velocity is not None:
            speed = np.asarray(self._entry.velocity, dtype=float)
        return JointLimits(
            tuple(self._model.names[number] for number in self._moved),
            np.where(free, -np.inf, self._model.lowerPositionLimit[first]),
            np.where(free, np.inf, self._model.upperPositionLimit[first]),
            speed,
            tuple("m" if slides else "rad" for slides in self.axes().prismatic),
        )

    def axes(self) -> JointAxes:
        """Return the axes of its joints."""
        columns = []
        for joint in self._joints:
            data = joint.createData()
            joint.calc(data, np.eye(joint.nq)[0])
            columns.append(np.asarray(data.S, dtype=float).reshape(6))
        slide, turn = np.array(columns)[:, :3], np.array(columns)[:, 3:]
        return JointAxes(slide + turn, np.any(slide != 0.0, axis=1))

    def configure(self, q: Array) -> None:
        """Put it at a configuration, shape (n,)."""
        for joint, value in zip(self._joints, q.tolist(), strict=True):
            if joint.nq == joint.nv:
                self._state[joint.idx_q] = value
            else:  # a continuous joint is kept as the cosine and the sine of its angle
                self._state[joint.idx_q] = np.cos(value)
                self._state[joint.idx_q + 1] = np.sin(value)
        self._current = False
        for body in self.bodies:
            body.pose = None

    def _update(self) -> None:
        if not self._current:
            pinocchio.forwardKinematics(self._model, self._data, self._state)
            pinocchio.updateGeometryPlacements(
                self._model, self._data, self._geometry, self._poses
            )
            self._current = True

    def pose(self, body: _Body) -> None:
        """Pose one of its bodies."""
        self._update()
        pose = self._base * self._poses.oMg[body.item]
        body.pose = coal.Transform3s(pose.rotation, pose.translation)

    def link_frames(self, q: Array) -> tuple[Array, Array]:
        """Return the rotations and positions of its base and its moved links."""
        return self._measured(q) if self._chain is None else self._chain.frames(q)

    def _measured(self, q: Array) -> tuple[Array, Array]:
        """Return where pinocchio puts its base and its moved links."""
        frames = np.empty((len(q), len(self._moved) + 1, 4, 4))
        frames[:, 0] = np.eye(4)
        for k, row in enumerate(q):
            self.configure(row)
            pinocchio.forwardKinematics(self._model, self._data, self._state)
            for j, number in enumerate(self._moved):
                frames[k, j + 1] = self._data.oMi[number].homogeneous
        frames = self._base.homogeneous @ frames
        return frames[..., :3, :3], frames[..., :3, 3]


def _geometry(form: Convex) -> Any:
    """Return a form as coal knows it."""
    if isinstance(form, Box):
        return coal.Box(*form.size)
    if isinstance(form, Cylinder):
        return coal.Cylinder(form.radius, form.length)
    if isinstance(form, Capsule):
        return coal.Capsule(form.radius, form.length)
    model = coal.BVHModelOBBRSS()
    model.beginModel(0, len(form))
    model.addVertices(form)
    model.endModel()
    return _convex(model)


def _convex(geometry: Any) -> Any:
    """Return a primitive as it is, of a mesh its convex hull."""
    if not hasattr(geometry, "buildConvexHull"):
        return geometry
    geometry.buildConvexHull(True, "Qt")
    return geometry.convex
