"""Robots and things for independent checks: loaded by pinocchio, measured by coal, and no capsules.

Shapes as coal knows them by itself: round things round, and hulls of what meshes are cut into.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import coal
import numpy as np
import pinocchio

from planning.cell.shape import Box, Capsule, Cylinder, Form, Shape
from planning.cell.workcell import PlacedRobot
from planning.robots.registry import ROBOTS
from planning.transforms import Array, Transform

_Posed = tuple[Any, Transform]


def coal_forms(shape: Shape) -> list[_Posed]:
    """Return coal's convex shapes of a shape, each with its pose in the frame of the shape."""
    return [
        (item, element.pose)
        for element in shape.elements
        for item in _forms(element.form)
    ]


def _forms(form: Form) -> list[Any]:
    if isinstance(form, Box):
        return [coal.Box(*form.size)]
    if isinstance(form, Cylinder):
        return [coal.Cylinder(form.radius, form.length)]
    if isinstance(form, Capsule):
        # Also without length: coal's own answer for a sphere deep in a cylinder is the way out
        # through the side, even where that through an end is shorter.
        return [coal.Capsule(form.radius, form.length)]
    return [_hull(points) for points in form.hulls]


def _hull(points: Array) -> Any:
    model = coal.BVHModelOBBRSS()
    model.beginModel(0, len(points))
    model.addVertices(np.asarray(points, dtype=np.float64))
    model.endModel()
    return _convex(model)


TOLERANCE = 2e-5
"""Distances may fall short of the clearance by this much: coal's are that exact [m]."""

_REQUEST = coal.DistanceRequest()
_RESULT = coal.DistanceResult()


@dataclass(frozen=True)
class ReferenceBody:
    """A convex body on a joint of a robot (or at rest in the world).

    Attributes:
        entity: what allowed contacts call it.
        joint: index of the joint that carries it, -1 for the base or the world.
        local: its pose in the joint's frame, shape (4, 4).
        shape: coal's shape.
        centre: of a sphere around it, in the joint's frame, shape (3,) [m].
        radius: of the sphere [m].
        weight: how far a unit of each joint can move any point of it, shape (n,) [m/rad].
    """

    entity: str
    joint: int
    local: Transform
    shape: Any
    centre: Array
    radius: float
    weight: Array


class ReferenceRobot:
    """A robot read anew from its URDF.

    Args:
        placed: which one; of its model only the file, names, frames and speeds are used.

    Attributes:
        base: its pose in the world, shape (4, 4).
        dof: number of joints n.
        turns: True for joints that turn, False for those that slide, shape (n,).
        speeds: greatest speed of each joint, shape (n,) [rad/s or m/s].
        parts: its convex bodies.
        flange: pose of the flange in the frame of the last joint, shape (4, 4).
        subspaces: along what each joint slides and about what it turns, in its frame, shape (3,) each.
    """

    def __init__(self, placed: PlacedRobot) -> None:
        model, geometry = _load(placed)
        self.base = placed.base
        self._model, self._data = model, model.createData()
        self.dof = model.nq
        self._limits = np.maximum(
            np.abs(model.lowerPositionLimit), np.abs(model.upperPositionLimit)
        )
        self.flange = placed.model.flange
        self.speeds = placed.model.velocity
        self.subspaces = [_subspace(joint) for joint in list(model.joints)[1:]]
        self.turns = np.array([bool(np.any(turn)) for _, turn in self.subspaces])
        tool = {part.body.name for part in placed.model.parts if part.group == "tool"}
        self.parts = []
        for item in geometry.geometryObjects:
            group = "tool" if item.name in tool else "arm"
            self.parts.append(
                self._part(
                    f"{placed.name}/{group}",
                    item.parentJoint - 1,
                    np.array(item.placement.homogeneous),
                    _convex(item.geometry),
                )
            )

    def loads(self, entity: str, shape: Shape, pose: Transform) -> list[ReferenceBody]:
        """Return what is held at ``pose`` in the flange frame as parts of the robot."""
        hand = self.flange @ pose
        return [
            self._part(entity, self.dof - 1, hand @ local, item)
            for item, local in coal_forms(shape)
        ]

    def joint_frame(self, q: Array, joint: int) -> Array:
        """Return the world pose of a joint at ``q``, of the base for -1, shape (4, 4)."""
        if joint < 0:
            return self.base
        pinocchio.forwardKinematics(self._model, self._data, np.asarray(q))
        return np.asarray(self.base @ self._data.oMi[joint + 1].homogeneous)

    def joint_frames_along(self, path: Array) -> Array:
        """Return world poses at many configurations at once, shape (s, n + 1, 4, 4).

        Args:
            path: configurations, shape (s, n).
        """
        frames = np.empty((len(path), self.dof + 1, 4, 4))
        frames[:, 0] = self.base
        for j in range(self.dof):
            moved = np.tile(np.eye(4), (len(path), 1, 1))
            slide, axis = self.subspaces[j]
            moved[:, :3, 3] = path[:, j, None] * slide
            cross = np.cross(np.eye(3), axis)  # of a turn by Rodrigues' formula
            moved[:, :3, :3] += np.sin(path[:, j])[:, None, None] * cross
            moved[:, :3, :3] += (1.0 - np.cos(path[:, j]))[:, None, None] * (
                cross @ cross
            )
            placement = self._model.jointPlacements[j + 1].homogeneous
            frames[:, j + 1] = frames[:, j] @ (placement @ moved)
        return frames

    def flange_pose(self, q: Array) -> Transform:
        """Return the world pose of the flange at ``q``, shape (4, 4)."""
        return np.asarray(self.joint_frame(q, self.dof - 1) @ self.flange)

    def _part(
        self, entity: str, joint: int, local: Transform, shape: Any
    ) -> ReferenceBody:
        shape.computeLocalAABB()
        middle, radius = np.array(shape.aabb_center), float(shape.aabb_radius)
        centre = local[:3, :3] @ middle + local[:3, 3]
        # A joint's turn moves a point by no more than its distance from the joint's origin,
        # which is at most the length of the chain between them.
        weight = np.zeros(self.dof)
        reach = float(np.linalg.norm(centre)) + radius
        for j in range(joint, -1, -1):
            slides = self._model.joints[j + 1].shortname().startswith("JointModelP")
            weight[j] = 1.0 if slides else reach
            reach += float(
                np.linalg.norm(self._model.jointPlacements[j + 1].translation)
            )
            reach += float(self._limits[j]) if slides else 0.0
        return ReferenceBody(entity, joint, local, shape, centre, radius, weight)


class SeenFrom:
    """A robot as it moves in the eyes of one of its own joints.

    Args:
        robot: the robot.
        joint: index of the joint, -1 for the base.

    Attributes:
        after: True for joints that move anything in its eyes, shape (n,).
        turns: True for those of them that turn, shape (n,).
    """

    def __init__(self, robot: ReferenceRobot, joint: int) -> None:
        self._robot, self._joint = robot, joint
        self.after = np.arange(robot.dof) > joint
        self.turns = robot.turns & self.after

    def joint_frame(self, q: Array, joint: int) -> Array:
        """Return the pose of a joint at ``q``, shape (4, 4)."""
        return np.asarray(self.joint_frames_along(np.asarray(q)[None])[0, joint + 1])

    def joint_frames_along(self, path: Array) -> Array:
        """Return poses of base and joints at many configurations, shape (s, n + 1, 4, 4)."""
        frames = self._robot.joint_frames_along(path)
        return np.asarray(inverses(frames[:, self._joint + 1, None]) @ frames)

    def seen(self, part: ReferenceBody) -> ReferenceBody:
        """Return a part of the robot as only the joints after this one move it."""
        return replace(part, weight=part.weight * self.after)


def inverses(poses: Array) -> Array:
    """Return the inverses of poses, shape (..., 4, 4)."""
    turned = np.swapaxes(poses[..., :3, :3], -1, -2)
    out = np.zeros_like(poses)
    out[..., :3, :3], out[..., 3, 3] = turned, 1.0
    out[..., :3, 3] = -(turned @ poses[..., :3, 3, None])[..., 0]
    return out


def resting_parts(entity: str, shape: Shape, pose: Transform) -> list[ReferenceBody]:
    """Return the parts of what rests in the world."""
    out = []
    for item, local in coal_forms(shape):
        item.computeLocalAABB()
        at = pose @ local
        middle = at[:3, :3] @ np.array(item.aabb_center) + at[:3, 3]
        radius = float(item.aabb_radius)
        out.append(ReferenceBody(entity, -1, at, item, middle, radius, np.zeros(0)))
    return out


def measure(
    a: ReferenceBody, frame_a: Transform, b: ReferenceBody, frame_b: Transform
) -> float:
    """Return the signed distance of two parts whose joints are at the given frames [m]."""
    return separation(a, frame_a, b, frame_b)[0]


def separation(
    a: ReferenceBody, frame_a: Transform, b: ReferenceBody, frame_b: Transform
) -> tuple[float, Array]:
    """Return the signed distance of two parts [m] and the direction from a to b, shape (3,)."""
    _RESULT.clear()
    pose_a, pose_b = frame_a @ a.local, frame_b @ b.local
    distance = coal.distance(
        a.shape,
        coal.Transform3s(pose_a[:3, :3], pose_a[:3, 3]),
        b.shape,
        coal.Transform3s(pose_b[:3, :3], pose_b[:3, 3]),
        _REQUEST,
        _RESULT,
    )
    return float(distance), np.array(_RESULT.normal)


def _subspace(joint: Any) -> tuple[Array, Array]:
    """Return along what a joint slides and about what it turns, each of shape (3,)."""
    data = joint.createData()
    joint.calc(data, np.zeros(1))
    column = np.asarray(data.S, dtype=np.float64).reshape(6)
    return column[:3], column[3:]


def _load(placed: PlacedRobot) -> tuple[Any, Any]:
    path = str(placed.model.urdf)
    dirs = [str(placed.model.urdf.parent), *map(str, placed.model.package_dirs)]
    model = pinocchio.buildModelFromUrdf(path)
    geometry = pinocchio.buildGeomFromUrdf(
        model, path, pinocchio.GeometryType.COLLISION, package_dirs=dirs
    )
    still = [
        name for name in list(model.names)[1:] if name not in placed.model.joint_names
    ]
    if still:
        q = pinocchio.neutral(model)
        entry = ROBOTS.get(placed.model.name)
        for name, value in ({} if entry is None else entry.frozen).items():
            q[model.joints[model.getJointId(name)].idx_q] = value
        ids = [model.getJointId(name) for name in still]
        model, geometry = pinocchio.buildReducedModel(model, geometry, ids, q)
    return model, geometry


def _convex(shape: Any) -> Any:
    if hasattr(shape, "buildConvexHull"):
        shape.buildConvexHull(True, "Qt")
        return shape.convex
    return shape
