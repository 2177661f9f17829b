"""Goal of a robot: a configuration, or a pose of one of its frames."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from planning.transforms import Array, Transform


@dataclass(frozen=True)
class RobotGoal:
    """Goal of a robot: a configuration, or a pose of one of its frames.

    Attributes:
        robot: the robot.
        joints: configuration, shape (n,), or None.
        pose: of the frame in the world, or None.
        frame: tool frame that goes to the pose.
        number: number of the move, from 1; a configuration that makes room has the number of the move that it
            makes room for.
        purpose: whether the robot moves to the goal that was asked for, makes room for another robot, or returns.
    """

    robot: str
    joints: Array | None = None
    pose: Transform | None = None
    frame: str = "tool"
    number: int = 0
    purpose: Literal["goal", "make room", "return"] = "goal"

    @property
    def label(self) -> str:
        """The motion in words."""
        if self.purpose == "make room":
            return f"out of the way of goal {self.number}"
        return f"{'back ' * (self.purpose == 'return')}to goal {self.number}"
