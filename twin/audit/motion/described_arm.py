"""A robot as its description has it, with pinocchio: for what its joints exert and how fast its tool is."""

from __future__ import annotations

import numpy as np
import pinocchio

from planning.cell.robot_model import RobotModel
from planning.robots.descriptions.fitting import written_options
from planning.robots.descriptions.xml_files import read_xml
from planning.robots.registry import ROBOTS
from planning.transforms import Array


class DescribedArm:
    """The joints and bodies in the file of a robot.

    Args:
        model: its file and the names of its joints are used.

    Attributes:
        body: all joints of the file; gravity is pinocchio's own.
        last: index of the robot's last joint in it.
        columns: where rates of the robot's joints are among all.
    """

    def __init__(self, model: RobotModel) -> None:
        self.body = body = pinocchio.buildModelFromUrdf(str(model.urdf))
        names = list(body.names)
        self._joints = [body.joints[names.index(name)] for name in model.joint_names]
        self.last = names.index(model.joint_names[-1])
        self.columns = [joint.idx_v for joint in self._joints]
        self._still = pinocchio.neutral(body)
        moved = set(model.joint_names)
        if held := [name for name in names[1:] if name not in moved]:
            known = written_options(read_xml(model.urdf))
            frozen = (known or ROBOTS[model.name]).frozen
            for name in held:
                self._still[body.joints[names.index(name)].idx_q] = frozen[name]

    def state(self, q: Array) -> Array:
        """Return a configuration as pinocchio has it, with the joints that are held.

        Args:
            q: joint values of the robot, shape (n,).
        """
        state = self._still.copy()
        for joint, value in zip(self._joints, q.tolist(), strict=True):
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
