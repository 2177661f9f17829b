"""A robot as pinocchio reads it from its description, as an oracle."""

from __future__ import annotations

import numpy as np
import pinocchio

from planning.cell.robot_model import RobotModel
from planning.kinematics.kinematics import frame_in_last_joint
from planning.robots.registry import ROBOTS


class PinocchioArm:
    """Kinematics and dynamics of a robot by its URDF; joints that are held stand where the registry has them.

    Args:
        model: of the robot.
        frame: whose origin is looked at.
    """

    def __init__(self, model: RobotModel, frame: str = "tool") -> None:
        whole = pinocchio.buildModelFromUrdf(str(model.urdf))
        held = [
            k
            for k in range(1, whole.njoints)
            if whole.names[k] not in model.joint_names
        ]
        at = pinocchio.neutral(whole)
        for name, value in ROBOTS[model.name].frozen.items():
            at[whole.joints[whole.getJointId(name)].idx_q] = value
        self.body = (
            pinocchio.buildReducedModel(whole, held, at) if held else whole.copy()
        )
        tip = pinocchio.SE3(frame_in_last_joint(model, frame))
        last = self.body.njoints - 1
        self._tip = self.body.addFrame(
            pinocchio.Frame("tip", last, tip, pinocchio.FrameType.OP_FRAME)
        )

    def tool_speeds(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the speeds of the frame's origin at some states, shape (rows,) [m/s]."""
        data = self.body.createData()
        found = []
        for row, rate in zip(q, v, strict=True):
            pinocchio.forwardKinematics(self.body, data, row, rate)
            pinocchio.updateFramePlacements(self.body, data)
            aligned = pinocchio.ReferenceFrame.LOCAL_WORLD_ALIGNED
            motion = pinocchio.getFrameVelocity(self.body, data, self._tip, aligned)
            found.append(np.linalg.norm(motion.linear))
        return np.array(found)
