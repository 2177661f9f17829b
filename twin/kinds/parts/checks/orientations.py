"""Tool orientations that a robot can reach, derived from the axes of its revolute joints.

The result is a single orientation, rotations about one or two axes, or all orientations. Prismatic joints do
not rotate the tool. Consecutive joints with parallel axes rotate it about one direction, as in a SCARA arm.
Joint limits are ignored.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from planning.cell.workcell import PlacedRobot
from planning.kinematics.kinematics import frame_pose, joint_poses_of
from planning.transforms import Array

_SAME = 2e-3
"""Tolerance for equal directions and orientations, since numbers in robot descriptions are rounded [rad]."""


def turning_axes(robot: PlacedRobot) -> list[Array]:
    """Return the world axes at HOME about which a robot can turn its tool, base to tip, without repeats.

    With three or more it gives its tool any orientation, as far as is known here.
    """
    chain, poses = robot.model.chain, joint_poses_of(robot, robot.home)
    axes: list[Array] = []
    for k in np.flatnonzero(~chain.prismatic):
        axis = poses[k + 1, :3, :3] @ chain.axis[k]
        if not axes or np.linalg.norm(np.cross(axes[-1], axis)) > _SAME:
            axes.append(axis)
    return axes


def can_turn(robot: PlacedRobot, frame: str, wanted: Array) -> bool:
    """Tell whether a robot can give a tool frame an orientation in the world, shape (3, 3)."""
    axes = turning_axes(robot)
    turn = wanted @ frame_pose(robot, robot.home, frame)[:3, :3].T
    if len(axes) == 0:
        return bool(Rotation.from_matrix(turn).magnitude() <= _SAME)
    if len(axes) == 1:
        return bool(np.linalg.norm(turn @ axes[0] - axes[0]) <= _SAME)
    # Of two rotations, each keeps its own axis: the angle between the axes stays.
    change = axes[0] @ (turn - np.eye(3)) @ axes[1]
    return len(axes) > 2 or bool(abs(change) <= _SAME)


def turning_words(robot: PlacedRobot, frame: str) -> str:
    """Return in words the orientations that a robot can give a tool frame."""
    axes, tool = turning_axes(robot), frame_pose(robot, robot.home, frame)[:3, :3]
    words = f"at {direction_words(tool[:, 2])}, y axis at {direction_words(tool[:, 1])}"
    if axes:
        about = " and ".join(map(direction_words, axes))
        return f"its joints turn its tool about {about} only, which is {words} at HOME"
    return f"its {robot.model.dof} slides turn nothing: tool direction fixed {words}"


def direction_words(vector: Array) -> str:
    """Return a direction in words."""
    return f"({', '.join(f'{value:.2f}' for value in (np.round(vector, 2) + 0.0).tolist())})"
