"""A robot's joints as flat arrays for compiled code."""

from __future__ import annotations

from functools import cache, lru_cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from planning.cell.robot_model import KinematicChain, RobotModel
from planning.cell.workcell import PlacedRobot
from planning.packed import packed
from planning.transforms import Array


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


NO_JOINTS = chain_table(
    KinematicChain(np.empty((0, 4, 4)), np.empty((0, 3)), np.empty(0, dtype=np.bool_)),
    np.empty(0),
    np.empty(0),
)
"""Carries what nothing carries."""


@cache
def joint_table(model: RobotModel) -> JointTable:
    """Return the joints of a robot, seen from its base."""
    return chain_table(model.chain, model.lower, model.upper)


@lru_cache(maxsize=1024)
def placed_joints(robot: PlacedRobot) -> JointTable:
    """Return the joints of a robot where it stands."""
    base = np.ascontiguousarray(robot.base, dtype=np.float64)
    return packed(joint_table(robot.model)._replace(base=base))
