"""A placed robot, and what it holds, as flat arrays for compiled code."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, lru_cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from planning.cell.body import ConvexBody
from planning.cell.robot_model import KinematicChain, RobotModel
from planning.cell.workcell import PlacedRobot
from planning.packed import packed
from planning.transforms import Array, Indices, Transform


class RobotKernel(NamedTuple):
    """Kinematics and capsules of one robot.

    Attributes:
        placement, axis, prismatic: see KinematicChain.
        base: pose of the base in the world, shape (4, 4).
        joint: the joint that moves each capsule, -1 for the base, shape (c,).
        start, end: capsule segments in the frame of their joint, shape (c, 3) [m].
        radius: capsule radii, shape (c,) [m].
        body: index of the body of each capsule, shape (c,): the robot's parts in order, then
            the objects it holds.
    """

    placement: Array
    axis: Array
    prismatic: npt.NDArray[np.bool_]
    base: Array
    joint: Indices
    start: Array
    end: Array
    radius: Array
    body: Indices


NO_ROBOT = packed(
    RobotKernel(
        np.empty((0, 4, 4)),
        np.empty((0, 3)),
        np.empty(0, dtype=np.bool_),
        np.eye(4),
        np.empty(0, dtype=np.int64),
        np.empty((0, 3)),
        np.empty((0, 3)),
        np.empty(0),
        np.empty(0, dtype=np.int64),
    )
)
"""Carries what nothing carries."""


class JointTable(NamedTuple):
    """Joints of one robot.

    Attributes:
        placement, axis, prismatic: see KinematicChain.
        base: pose of the base in the world, the identity where all is seen from it, shape
            (4, 4).
        lower, upper: joint limits, shape (n,) [rad or m].
    """

    placement: Array
    axis: Array
    prismatic: npt.NDArray[np.bool_]
    base: Array
    lower: Array
    upper: Array


def chain_table(chain: KinematicChain, lower: Array, upper: Array) -> JointTable:
    """Return joints seen from their base."""
    table = JointTable(
        np.ascontiguousarray(chain.placement, dtype=np.float64),
        np.ascontiguousarray(chain.axis, dtype=np.float64),
        np.ascontiguousarray(chain.prismatic, dtype=np.bool_),
        np.eye(4),
        np.ascontiguousarray(lower, dtype=np.float64),
        np.ascontiguousarray(upper, dtype=np.float64),
    )
    return packed(table)


@cache
def joint_table(model: RobotModel) -> JointTable:
    """Return the joints of a robot, seen from its base."""
    return chain_table(model.chain, model.lower, model.upper)


@lru_cache(maxsize=1024)
def placed_joints(robot: PlacedRobot) -> JointTable:
    """Return the joints of a robot where it stands."""
    base = np.ascontiguousarray(robot.base, dtype=np.float64)
    return packed(joint_table(robot.model)._replace(base=base))


def robot_kernel(
    robot: PlacedRobot, held: Sequence[tuple[ConvexBody, Transform]] = ()
) -> RobotKernel:
    """Return the arrays of a robot and of what it holds.

    Args:
        robot: the placed robot.
        held: bodies in the hand, each with its pose in the flange frame.
    """
    bare = _bare(robot)
    return _join(bare, _collect(robot.model, held, parts=False)) if held else bare


@lru_cache(maxsize=1024)
def _bare(robot: PlacedRobot) -> RobotKernel:
    base = np.ascontiguousarray(robot.base, dtype=np.float64)
    return packed(_parts(robot.model)._replace(base=base))


@cache
def _parts(model: RobotModel) -> RobotKernel:
    return _collect(model, ())


def _join(first: RobotKernel, second: RobotKernel) -> RobotKernel:
    """Return a robot with the bodies of both."""
    joined = first._replace(
        joint=np.concatenate([first.joint, second.joint]),
        start=np.concatenate([first.start, second.start]),
        end=np.concatenate([first.end, second.end]),
        radius=np.concatenate([first.radius, second.radius]),
        body=np.concatenate([first.body, second.body]),
    )
    return packed(joined)


def _collect(
    model: RobotModel,
    held: Sequence[tuple[ConvexBody, Transform]],
    *,
    parts: bool = True,
) -> RobotKernel:
    """Return the arrays of a robot's parts, if wanted, and of what it holds, its base aside."""
    joint: list[Indices] = []
    start: list[Array] = []
    end: list[Array] = []
    radius: list[Array] = []
    body: list[Indices] = []

    def add(which: int, carrier: int, capsules_of: ConvexBody, pose: Transform) -> None:
        capsules = capsules_of.capsules
        count = len(capsules.radius)
        joint.append(np.full(count, carrier))
        start.append(capsules.start @ pose[:3, :3].T + pose[:3, 3])
        end.append(capsules.end @ pose[:3, :3].T + pose[:3, 3])
        radius.append(capsules.radius)
        body.append(np.full(count, which))

    for index, part in enumerate(model.parts if parts else ()):
        add(index, part.joint, part.body, np.eye(4))
    for index, (item, pose) in enumerate(held):
        add(len(model.parts) + index, model.dof - 1, item, model.flange @ pose)
    return RobotKernel(
        np.ascontiguousarray(model.chain.placement, dtype=np.float64),
        np.ascontiguousarray(model.chain.axis, dtype=np.float64),
        np.ascontiguousarray(model.chain.prismatic, dtype=np.bool_),
        np.eye(4),
        np.ascontiguousarray(np.concatenate(joint), dtype=np.int64),
        np.ascontiguousarray(np.concatenate(start), dtype=np.float64),
        np.ascontiguousarray(np.concatenate(end), dtype=np.float64),
        np.ascontiguousarray(np.concatenate(radius), dtype=np.float64),
        np.ascontiguousarray(np.concatenate(body), dtype=np.int64),
    )
