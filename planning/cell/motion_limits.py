"""Limits of motion of one robot: speed, acceleration and jerk."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planning.cell.robot_model import RobotModel
from planning.transforms import Array

TURNING_ACCELERATION, SLIDING_ACCELERATION = 5.0, 2.0
"""Default accelerations of revolute and prismatic joints [rad/s^2, m/s^2]."""

_RISE_TIME_S = 0.05
"""Rise time of an acceleration where no jerk limit is stated [s]."""


@dataclass(frozen=True, eq=False)
class MotionLimits:
    """Limits that a robot keeps to wherever it moves.

    Attributes:
        velocity: of each joint, shape (n,) [rad/s or m/s].
        acceleration: of each joint, shape (n,) [rad/s^2 or m/s^2].
        jerk: of each joint, shape (n,), infinite for none [rad/s^3 or m/s^3].
        sum_of_speeds: most that all joint speeds add up to, infinite for no such limit [rad/s].
        tool_speed: of the tool's frame, infinite for none [m/s].
        loaded_tool_speed: the same while something is in hand [m/s].
    """

    velocity: Array
    acceleration: Array
    jerk: Array
    sum_of_speeds: float = np.inf
    tool_speed: float = np.inf
    loaded_tool_speed: float = np.inf

    @classmethod
    def of(cls, model: RobotModel) -> MotionLimits:
        """Return the motion limits of a robot type, with defaults where its description has none."""
        usual = np.where(
            model.chain.prismatic, SLIDING_ACCELERATION, TURNING_ACCELERATION
        ).astype(np.float64)
        drives = model.drives
        given = usual if drives is None else drives.acceleration
        acceleration = np.where(np.isfinite(given), given, usual)
        known = acceleration * np.inf if drives is None else drives.jerk
        jerk = np.where(np.isfinite(known), known, acceleration / _RISE_TIME_S)
        return cls(model.velocity, acceleration, jerk)
