"""Serial chains as flat arrays, and their forward kinematics, in compiled code."""

from __future__ import annotations

from functools import cache, lru_cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from planning.cell.robot_model import KinematicChain, RobotModel
from planning.cell.workcell import PlacedRobot, PoseError
from planning.kernels import inner_kernel, kernel
from planning.packed import packed
from planning.transforms import Array, Transform


class JointTable(NamedTuple):
    """Joints of one robot.

    Attributes:
        placement, axis, prismatic: see KinematicChain.
        base: pose of the base in the world, the identity where all is seen from it, shape
            (4, 4).
        lower, upper: joint limits, shape (n,) [rad or m].
        error: of the base, see PoseError: displacement and angle, shape (2,) [m, rad].
    """

    placement: Array
    axis: Array
    prismatic: npt.NDArray[np.bool_]
    base: Array
    lower: Array
    upper: Array
    error: Array


def chain_table(chain: KinematicChain, lower: Array, upper: Array) -> JointTable:
    """Return joints relative to their base."""
    table = JointTable(
        np.ascontiguousarray(chain.placement, dtype=np.float64),
        np.ascontiguousarray(chain.axis, dtype=np.float64),
        np.ascontiguousarray(chain.prismatic, dtype=np.bool_),
        np.eye(4),
        np.ascontiguousarray(lower, dtype=np.float64),
        np.ascontiguousarray(upper, dtype=np.float64),
        np.zeros(2),
    )
    return packed(table)


@cache
def empty_chain_table() -> JointTable:
    """Return the joints of what no robot carries: none."""
    none = np.empty((0, 4, 4)), np.empty((0, 3)), np.empty(0, dtype=np.bool_)
    return chain_table(KinematicChain(*none), np.empty(0), np.empty(0))


@cache
def joint_table(model: RobotModel) -> JointTable:
    """Return the joints of a robot, relative to its base."""
    return chain_table(model.chain, model.lower, model.upper)


@lru_cache(maxsize=1024)
def placed_joints(robot: PlacedRobot) -> JointTable:
    """Return the joints of a robot at its pose in the world."""
    return standing_at(joint_table(robot.model), robot.base, robot.base_error)


def standing_at(joints: JointTable, base: Transform, error: PoseError) -> JointTable:
    """Return joints on a base in the world, shape (4, 4), that may be off by an error."""
    base = np.ascontiguousarray(base, dtype=np.float64)
    off = np.array([error.m, error.rad])
    return packed(joints._replace(base=base, error=off))


@kernel
def pose_joints(joints: JointTable, q: Array, out: Array) -> None:
    """Write the world pose of the base and of every joint frame after its motion.

    Args:
        joints: of the robot.
        q: joint values, shape (n,).
        out: shape (n + 1, 4, 4); ``out[0]`` becomes the base, ``out[j + 1]`` joint j.
    """
    placement, axis = joints.placement, joints.axis
    prismatic, base = joints.prismatic, joints.base
    n = q.shape[0]
    for r in range(4):
        for c in range(4):
            out[0, r, c] = base[r, c]
    # Nothing but numbers in the loop: a view costs as much as a few lines of it.
    for j in range(n):
        x, y, z = axis[j, 0], axis[j, 1], axis[j, 2]
        tx, ty, tz = placement[j, 0, 3], placement[j, 1, 3], placement[j, 2, 3]
        m00 = m11 = m22 = 1.0
        m01 = m02 = m10 = m12 = m20 = m21 = 0.0
        if prismatic[j]:
            tx += q[j] * (
                placement[j, 0, 0] * x + placement[j, 0, 1] * y + placement[j, 0, 2] * z
            )
            ty += q[j] * (
                placement[j, 1, 0] * x + placement[j, 1, 1] * y + placement[j, 1, 2] * z
            )
            tz += q[j] * (
                placement[j, 2, 0] * x + placement[j, 2, 1] * y + placement[j, 2, 2] * z
            )
        else:
            cq, sq = np.cos(q[j]), np.sin(q[j])
            v = 1.0 - cq
            m00, m01, m02 = cq + x * x * v, x * y * v - z * sq, x * z * v + y * sq
            m10, m11, m12 = y * x * v + z * sq, cq + y * y * v, y * z * v - x * sq
            m20, m21, m22 = z * x * v - y * sq, z * y * v + x * sq, cq + z * z * v
        for r in range(3):
            p0, p1, p2 = out[j, r, 0], out[j, r, 1], out[j, r, 2]
            a0 = (
                p0 * placement[j, 0, 0]
                + p1 * placement[j, 1, 0]
                + p2 * placement[j, 2, 0]
            )
            a1 = (
                p0 * placement[j, 0, 1]
                + p1 * placement[j, 1, 1]
                + p2 * placement[j, 2, 1]
            )
            a2 = (
                p0 * placement[j, 0, 2]
                + p1 * placement[j, 1, 2]
                + p2 * placement[j, 2, 2]
            )
            out[j + 1, r, 0] = a0 * m00 + a1 * m10 + a2 * m20
            out[j + 1, r, 1] = a0 * m01 + a1 * m11 + a2 * m21
            out[j + 1, r, 2] = a0 * m02 + a1 * m12 + a2 * m22
            out[j + 1, r, 3] = p0 * tx + p1 * ty + p2 * tz + out[j, r, 3]
        out[j + 1, 3, 0] = out[j + 1, 3, 1] = out[j + 1, 3, 2] = 0.0
        out[j + 1, 3, 3] = 1.0


@inner_kernel
def joint_axis(joints: JointTable, poses: Array, j: int) -> tuple[float, float, float]:
    """Return the axis of a joint in the world, its frame being ``poses[j + 1]``."""
    axis, p = joints.axis, j + 1
    x, y, z = axis[j, 0], axis[j, 1], axis[j, 2]
    return (
        poses[p, 0, 0] * x + poses[p, 0, 1] * y + poses[p, 0, 2] * z,
        poses[p, 1, 0] * x + poses[p, 1, 1] * y + poses[p, 1, 2] * z,
        poses[p, 2, 0] * x + poses[p, 2, 1] * y + poses[p, 2, 2] * z,
    )
