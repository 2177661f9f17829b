"""A robot as pinocchio reads its description: states, rates and speeds of its joints."""

from __future__ import annotations

import numpy as np
import pinocchio

from planning.cell.robot_model import RobotModel
from planning.errors import RobotModelError
from planning.robots.registry import ROBOTS
from planning.transforms import Array


class DescribedArm:
    """The joints and bodies in the description of a robot.

    Args:
        model: its file and the names of its joints are used.
        text: the description in place of the file's.

    Attributes:
        body: all joints of the description; gravity is pinocchio's own.
        moved: indices of the robot's joints among them.
        columns: where rates of the robot's joints are among all.

    Raises:
        RobotModelError: it cannot be read, or has other joints.
    """

    def __init__(self, model: RobotModel, text: str | None = None) -> None:
        try:
            if text is None:
                body = pinocchio.buildModelFromUrdf(str(model.urdf))
            else:
                body = pinocchio.buildModelFromXML(text)
        except (ValueError, RuntimeError) as error:
            raise RobotModelError(f"cannot read {model.urdf}: {error}") from error
        names = list(body.names)
        missing = [name for name in model.joint_names if name not in names]
        if missing:
            raise RobotModelError(
                f"{model.urdf} has no joint {missing[0]!r}", choices=tuple(names[1:])
            )
        self.body = body
        self.moved = [names.index(name) for name in model.joint_names]
        self.joints = [body.joints[number] for number in self.moved]
        self.columns = [joint.idx_v for joint in self.joints]
        self._still = pinocchio.neutral(body)
        entry = ROBOTS.get(model.name)
        for name, value in (entry.frozen if entry else {}).items():
            self._still[body.joints[names.index(name)].idx_q] = value

    @property
    def last(self) -> int:
        """Index of the robot's last joint."""
        return self.moved[-1]

    def state(self, q: Array) -> Array:
        """Return a configuration as pinocchio has it, with the joints that are held.

        Args:
            q: joint values of the robot, shape (n,).
        """
        state = self._still.copy()
        for joint, value in zip(self.joints, q.tolist(), strict=True):
            if joint.nq == joint.nv:
                state[joint.idx_q] = value
            else:  # a continuous joint is kept as the cosine and the sine of its angle
                state[joint.idx_q : joint.idx_q + 2] = np.cos(value), np.sin(value)
        return np.asarray(state)

    def rates(self, v: Array) -> Array:
        """Return speeds or accelerations of all joints, shape (all joints,).

        Args:
            v: those of the robot's, shape (n,).
        """
        rates = np.zeros(self.body.nv)
        rates[self.columns] = v
        return rates

    def point_speeds(self, q: Array, v: Array, point: Array) -> Array:
        """Return how fast a point goes that is fixed to the last joint, shape (m,) [m/s].

        Args:
            q, v: states of the robot, shape (m, n).
            point: in the frame of the last joint, shape (3,) [m].
        """
        data, speeds = self.body.createData(), np.empty(len(q))
        for k in range(len(q)):
            at, rates = self.state(q[k]), self.rates(v[k])
            pinocchio.forwardKinematics(self.body, data, at, rates)
            motion = data.v[self.last]
            speeds[k] = np.linalg.norm(motion.linear + np.cross(motion.angular, point))
        return speeds
