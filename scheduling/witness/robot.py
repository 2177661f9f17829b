"""Robot model read by pinocchio from a URDF file: joints, limits, convex parts and their poses."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio

from planning.cell.shape import Shape
from planning.cell.workcell import PlacedRobot
from planning.errors import RobotModelError
from planning.robots.descriptions.fitting import ignored_pairs
from planning.robots.descriptions.xml_files import read_xml
from planning.robots.registry import ROBOTS
from planning.transforms import Array, Transform
from scheduling.witness.parts import ConvexPart
from scheduling.witness.shapes import coal_forms, convex_of


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


class WitnessRobot:
    """A robot read independently from its URDF: a chain of joints, with held ones fixed.

    Args:
        placed: the robot; of its model only the file, names, frames and speeds are used.

    Attributes:
        base: pose of its base in the world, shape (4, 4).
        dof: number of joints n.
        model: pinocchio's, of these joints, with masses.
        axes: along or about which each joint moves, in the joint's frame, shape (n, 3).
        turns: True for joints that turn, False for those that slide, shape (n,).
        speeds: greatest speed of each joint, shape (n,) [rad/s or m/s].
        limits: what the URDF allows its joints.
        parts: its convex bodies.
        links: name of the link that each of them belongs to.
        flange: pose of the flange in the frame of the last joint, shape (4, 4).
        ignored: pairs of indices of parts (low, high) whose links its description exempts from checks.

    Raises:
        RobotModelError: the description cannot be read, or has other joints.
    """

    def __init__(self, placed: PlacedRobot) -> None:
        model, geometry = _load(placed)
        self.base, self.flange = placed.base, placed.model.flange
        self._base = pinocchio.SE3(placed.base)
        self.speeds = placed.model.velocity
        self.model, self._data = model, model.createData()
        self._joints = list(model.joints)[1:]
        self.dof = len(self._joints)
        columns = np.array([_subspace(joint) for joint in self._joints]).reshape(-1, 6)
        self.axes = columns[:, :3] + columns[:, 3:]
        self.turns = np.any(columns[:, 3:] != 0.0, axis=1)
        # The pose of each joint in the one before it: that at 0, and what multiplies the sine and
        # one less the cosine of its angle (by Rodrigues' formula), or how far it has slid.
        self._placed = np.zeros((self.dof, 3, 4, 4))
        for j, pose in enumerate(list(model.jointPlacements)[1:]):
            moved = np.zeros((3, 4, 4))
            moved[0] = np.eye(4)
            if self.turns[j]:
                moved[1, :3, :3] = np.cross(np.eye(3), self.axes[j])
                moved[2, :3, :3] = moved[1, :3, :3] @ moved[1, :3, :3]
            else:
                moved[1, :3, 3] = self.axes[j]
            self._placed[j] = pose.homogeneous @ moved
        self.limits = self._read_limits(placed)
        tool = {part.body.name for part in placed.model.parts if part.group == "tool"}
        self.parts, self.links = [], []
        for item in geometry.geometryObjects:
            group = "tool" if item.name in tool else "arm"
            self.parts.append(
                self._part(
                    f"{placed.name}/{group}",
                    item.parentJoint - 1,
                    np.array(item.placement.homogeneous),
                    convex_of(item.geometry),
                )
            )
            # pinocchio names shapes "<link>_<number>".
            self.links.append(item.name.rsplit("_", 1)[0])
        self.ignored = self._ignored_parts(placed.model.urdf)

    def _ignored_parts(self, path: Path) -> frozenset[tuple[int, int]]:
        pairs = set(map(frozenset, ignored_pairs(read_xml(path))))
        return frozenset(
            (i, j)
            for (i, a), (j, b) in combinations(enumerate(self.links), 2)
            if frozenset((a, b)) in pairs
        )

    def state(self, q: Array) -> Array:
        """Return a configuration, shape (n,), in pinocchio's form.

        It keeps a continuous joint as the cosine and the sine of its angle.
        """
        if self.model.nq == self.dof:
            return np.asarray(q)
        state = np.empty(self.model.nq)
        for joint, value in zip(self._joints, q.tolist(), strict=True):
            own = (value,) if joint.nq == 1 else (np.cos(value), np.sin(value))
            state[joint.idx_q : joint.idx_q + joint.nq] = own
        return state

    def loads(self, entity: str, shape: Shape, pose: Transform) -> list[ConvexPart]:
        """Return objects held at ``pose`` in the flange frame as parts of the robot."""
        hand = self.flange @ pose
        return [
            self._part(entity, self.dof - 1, hand @ local, item)
            for item, local in coal_forms(shape)
        ]

    def joint_frame(self, q: Array, joint: int) -> Array:
        """Return the world pose of a joint at ``q``, of the base for -1, shape (4, 4)."""
        if joint < 0:
            return self.base
        pinocchio.forwardKinematics(self.model, self._data, self.state(q))
        return np.asarray(self.base @ self._data.oMi[joint + 1].homogeneous)

    def joint_placements(self, q: Array) -> list[Any]:
        """Return the world poses of base and joints at ``q`` in the form of pinocchio and coal."""
        pinocchio.forwardKinematics(self.model, self._data, self.state(q))
        return [self._base * pose for pose in self._data.oMi]

    def joint_frames(self, q: Array) -> Array:
        """Return the world poses of base and joints at ``q``, shape (n + 1, 4, 4)."""
        return np.array([pose.homogeneous for pose in self.joint_placements(q)])

    def joint_frames_along(self, path: Array) -> Array:
        """Return world poses at many configurations, shape (s, n + 1, 4, 4).

        Args:
            path: configurations, shape (s, n).
        """
        frames = np.empty((len(path), self.dof + 1, 4, 4))
        frames[:, 0] = self.base
        share = np.stack(
            [np.ones_like(path), np.sin(path), 1.0 - np.cos(path)], axis=-1
        )
        share[:, ~self.turns, 1] = path[:, ~self.turns]
        placed = np.einsum("snk,nkij->snij", share, self._placed)
        for j in range(self.dof):
            frames[:, j + 1] = frames[:, j] @ placed[:, j]
        return frames

    def flange_pose(self, q: Array) -> Transform:
        """Return the world pose of the flange at ``q``, shape (4, 4)."""
        return np.asarray(self.joint_frame(q, self.dof - 1) @ self.flange)

    def point_speeds(self, q: Array, v: Array, point: Array) -> Array:
        """Return the speeds of a point fixed to the last joint, shape (m,) [m/s].

        Args:
            q, v: configurations and joint speeds, shape (m, n).
            point: in the frame of the last joint, shape (3,) [m].
        """
        speeds = np.empty(len(q))
        for k in range(len(q)):
            pinocchio.forwardKinematics(
                self.model, self._data, self.state(q[k]), np.asarray(v[k])
            )
            motion = self._data.v[self.dof]
            speeds[k] = np.linalg.norm(motion.linear + np.cross(motion.angular, point))
        return speeds

    def _read_limits(self, placed: PlacedRobot) -> JointLimits:
        model, entry = self.model, ROBOTS.get(placed.model.name)
        first = [joint.idx_q for joint in self._joints]
        free = np.array([joint.nq > joint.nv for joint in self._joints])
        velocity = model.velocityLimit
        if entry and entry.velocity is not None:  # in place of what the URDF says
            velocity = np.asarray(entry.velocity, dtype=float)
        return JointLimits(
            tuple(model.names)[1:],
            np.where(free, -np.inf, model.lowerPositionLimit[first]),
            np.where(free, np.inf, model.upperPositionLimit[first]),
            np.array(velocity),
            tuple("rad" if turns else "m" for turns in self.turns),
        )

    def _part(
        self, entity: str, joint: int, local: Transform, shape: Any
    ) -> ConvexPart:
        shape.computeLocalAABB()
        middle, radius = np.array(shape.aabb_center), float(shape.aabb_radius)
        centre = local[:3, :3] @ middle + local[:3, 3]
        # A joint's turn moves a point by no more than its distance from the joint's origin,
        # which is at most the length of the chain between them.
        weight = np.zeros(self.dof)
        reach = float(np.linalg.norm(centre)) + radius
        for j in range(joint, -1, -1):
            weight[j] = reach if self.turns[j] else 1.0
            reach += float(
                np.linalg.norm(self.model.jointPlacements[j + 1].translation)
            )
            if not self.turns[j]:
                lower, upper = self.limits.lower[j], self.limits.upper[j]
                reach += max(abs(float(lower)), abs(float(upper)))
        return ConvexPart(entity, joint, local, shape, centre, radius, weight)


class SeenFrom:
    """A robot in the frame of one of its own joints.

    Args:
        robot: the robot.
        joint: index of the joint, -1 for the base.

    Attributes:
        after: True for joints that move anything in its eyes, shape (n,).
        turns: True for those of them that turn, shape (n,).
    """

    def __init__(self, robot: WitnessRobot, joint: int) -> None:
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

    def seen(self, part: ConvexPart) -> ConvexPart:
        """Return a part of the robot as moved only by the joints after this one."""
        return replace(part, weight=part.weight * self.after)


def inverses(poses: Array) -> Array:
    """Return the inverses of poses, shape (..., 4, 4)."""
    turned = np.swapaxes(poses[..., :3, :3], -1, -2)
    out = np.zeros_like(poses)
    out[..., :3, :3], out[..., 3, 3] = turned, 1.0
    out[..., :3, 3] = -(turned @ poses[..., :3, 3, None])[..., 0]
    return out


def _subspace(joint: Any) -> Array:
    """Return the direction and the axis of a joint's motion, shape (6,)."""
    data = joint.createData()
    joint.calc(data, np.eye(joint.nq)[0])
    return np.asarray(data.S, dtype=np.float64).reshape(6)


def _load(placed: PlacedRobot) -> tuple[Any, Any]:
    """Return pinocchio's model and collision geometry of a robot, with other joints fixed."""
    described = placed.model
    path = str(described.urdf)
    dirs = [str(described.urdf.parent), *map(str, described.package_dirs)]
    try:
        model = pinocchio.buildModelFromUrdf(path)
        geometry = pinocchio.buildGeomFromUrdf(
            model, path, pinocchio.GeometryType.COLLISION, package_dirs=dirs
        )
    except (ValueError, RuntimeError) as error:
        raise RobotModelError(f"cannot read {path}: {error}") from error
    names = list(model.names)[1:]
    missing = [name for name in described.joint_names if name not in names]
    if missing:
        raise RobotModelError(
            f"{path} has no joint {missing[0]!r}", choices=tuple(names)
        )
    still = [name for name in names if name not in described.joint_names]
    if still:
        q = pinocchio.neutral(model)
        entry = ROBOTS.get(described.name)
        for name, value in (entry.frozen if entry else {}).items():
            q[model.joints[model.getJointId(name)].idx_q] = value
        ids = [model.getJointId(name) for name in still]
        model, geometry = pinocchio.buildReducedModel(model, geometry, ids, q)
    return model, geometry
