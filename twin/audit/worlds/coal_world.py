"""The audit's own copy of the cell in coal, for where PyBullet is not installed.

The planner measures with coal too, but not this way: here pinocchio reads the URDF files and
poses the robots, primitives stay what they are, and nothing is decided before it is measured.
PyBullet is the stronger witness all the same: it shares no library with the planner.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import coal
import numpy as np
import pinocchio

from planning.cell.shape import Box, Capsule, Cylinder
from planning.cell.workcell import PlacedRobot, Workcell
from planning.transforms import Array, Transform
from twin.audit.worlds.link_chain import DescribedArm, Frames, JointAxes, ShapeLink
from twin.audit.worlds.world import BASE, AuditWorld, Convex, JointLimits, WatchedShape


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


class CoalWorld(AuditWorld):
    """Shapes that are posed and measured two by two, with nothing in between.

    Args:
        cell: what to load.
    """

    def __init__(self, cell: Workcell) -> None:
        self._request, self._result = coal.DistanceRequest(), coal.DistanceResult()
        self._bodies: list[_Body] = []
        self._arms: list[_Arm] = []
        super().__init__(cell)

    def close(self) -> None:
        """Do nothing: coal holds nothing that is not freed by itself."""

    def _load(self, robot: PlacedRobot, text: str) -> tuple[JointAxes, JointLimits]:
        arm = _Arm(robot, text)
        self._arms.append(arm)
        return arm.axes(), arm.limits()

    def _link(
        self, robot: int, link: ShapeLink, entity: str, detail: str
    ) -> WatchedShape:
        arm = self._arms[robot]
        k, item = arm.items[link.link]
        carrier = item.parentJoint
        while carrier and carrier not in arm.moved:
            carrier = arm.body.parents[carrier]
        body = _Body(_convex(item.geometry), item=k)
        arm.bodies.append(body)
        there = arm.placed().oMg[k]
        pose = arm.data.oMi[carrier].inverse() * there
        shape = body.geometry
        shape.computeLocalAABB()
        half = 0.5 * np.asarray(shape.aabb_local.max_ - shape.aabb_local.min_)
        centre = np.asarray(pose.act(np.asarray(shape.aabb_center)))
        joint = arm.moved.index(carrier) if carrier else BASE
        around = centre, float(shape.aabb_radius), half, np.asarray(pose.rotation)
        number = self._know(body)
        return WatchedShape(entity, detail, number, robot, joint, *around)

    def _know(self, body: _Body) -> int:
        self._bodies.append(body)
        return len(self._bodies) - 1

    def _body(self, form: Convex) -> int:
        return self._know(_Body(_geometry(form)))

    def place(self, item: WatchedShape, pose: Transform) -> None:
        """Pose a shape of a fixture or an object."""
        self._bodies[item.number].pose = coal.Transform3s(pose[:3, :3], pose[:3, 3])

    def configure(self, robot: int, q: Array) -> None:
        """Put a robot at a configuration, shape (n,)."""
        self._arms[robot].configure(q)

    def _measured(self, robot: int, q: Array) -> Frames:
        arm = self._arms[robot]
        data, frames = (
            arm.body.createData(),
            np.empty((len(q), len(arm.moved) + 1, 4, 4)),
        )
        frames[:, 0] = np.eye(4)
        for k, row in enumerate(q):
            pinocchio.forwardKinematics(arm.body, data, arm.state(row))
            for j, number in enumerate(arm.moved):
                frames[k, j + 1] = data.oMi[number].homogeneous
        frames = arm.base.homogeneous @ frames
        return frames[..., :3, :3], frames[..., :3, 3]

    def distance(self, a: WatchedShape, b: WatchedShape, reach: float) -> float:
        """Return the signed distance of two shapes as they are placed now [m]."""
        first, second = self._bodies[a.number], self._bodies[b.number]
        for shape, body in ((a, first), (b, second)):
            if body.pose is None:
                assert shape.robot is not None
                arm = self._arms[shape.robot]
                body.pose = arm.base * arm.placed().oMg[body.item]
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


class _Arm(DescribedArm):
    """A robot that pinocchio poses.

    Args:
        placed: which one; names, files, and the poses of its base and HOME are used.
        text: its description.

    Attributes:
        base: pose of its base.
        data: pinocchio's, of all joints.
        items: number and shape of each link that has one, by name.
        bodies: of its shapes.
    """

    def __init__(self, placed: PlacedRobot, text: str) -> None:
        super().__init__(placed.model, text)
        self.base = pinocchio.SE3(placed.base)
        self._geometry = pinocchio.buildGeomFromUrdfString(
            self.body, text, pinocchio.GeometryType.COLLISION
        )
        self.items = {
            self.body.frames[item.parentFrame].name: (k, item)
            for k, item in enumerate(self._geometry.geometryObjects)
        }
        self.data, self._poses = self.body.createData(), self._geometry.createData()
        self.bodies: list[_Body] = []
        self.configure(placed.home)

    def limits(self) -> JointLimits:
        """Return the limits that the URDF gives the joints."""
        first = [joint.idx_q for joint in self.joints]
        free = np.array([joint.nq > joint.nv for joint in self.joints])
        return JointLimits(
            tuple(self.body.names[number] for number in self.moved),
            np.where(free, -np.inf, self.body.lowerPositionLimit[first]),
            np.where(free, np.inf, self.body.upperPositionLimit[first]),
            self.body.velocityLimit[self.columns],
            tuple("m" if slides else "rad" for slides in self.axes().prismatic),
        )

    def axes(self) -> JointAxes:
        """Return the axes of its joints."""
        columns = []
        for joint in self.joints:
            data = joint.createData()
            joint.calc(data, np.eye(joint.nq)[0])
            columns.append(np.asarray(data.S, dtype=float).reshape(6))
        slide, turn = np.array(columns)[:, :3], np.array(columns)[:, 3:]
        return JointAxes(slide + turn, np.any(slide != 0.0, axis=1))

    def configure(self, q: Array) -> None:
        """Put it at a configuration, shape (n,)."""
        self._q, self._current = q, False
        for body in self.bodies:
            body.pose = None

    def placed(self) -> Any:
        """Return pinocchio's poses of its shapes where it is, as seen from its base."""
        if not self._current:
            pinocchio.forwardKinematics(self.body, self.data, self.state(self._q))
            pinocchio.updateGeometryPlacements(
                self.body, self.data, self._geometry, self._poses
            )
            self._current = True
        return self._poses


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
