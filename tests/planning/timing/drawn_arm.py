"""Robots drawn at random, with something in their hands, for tests of what joints exert; and pinocchio as their oracle."""

import numpy as np
import pinocchio
import pytest

from planning.cell.motion_limits import MotionLimits
from planning.cell.robot_model import RobotModel
from planning.cell.shape import box_shape
from planning.cell.workcell import PlacedRobot
from planning.robots.registry import ROBOTS, robot_model
from planning.timing.torque import ArmDynamics, HandPayload
from planning.transforms import from_rpy


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
        tip = pinocchio.SE3(model.frame_in_last_joint(frame))
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


ARMS = ("ur5e", "panda", "iiwa14")
MODELS = [
    ARMS[0],
    *(pytest.param(name, marks=pytest.mark.nightly) for name in ARMS[1:]),
]
"""Arms that are drawn; all but the first one at night."""


class Drawn:
    """A robot with something in its hand, hung up somehow, and quick limits."""

    def __init__(self, name: str, seed: int) -> None:
        self.rng = rng = np.random.default_rng(seed)
        model = robot_model(name)
        base = from_rpy(
            rng.normal(size=3), rng.choice([0.0, 1.0], 3) * rng.normal(size=3)
        )
        self.robot = PlacedRobot(name, model, base, model.home)
        mass = float(rng.choice([0.0, 1.0, 2.5]))
        box = box_shape("part", rng.uniform(0.02, 0.3, 3))
        pose = from_rpy(rng.uniform(-0.1, 0.1, 3), rng.normal(size=3))
        self.payload = HandPayload(mass, box, pose)
        held = [self.payload] if mass else []
        self.dynamics = ArmDynamics(self.robot, model, held)
        usual = MotionLimits.of(model)
        scale = rng.choice([1.0, 4.0, 10.0])
        self.limits = MotionLimits(
            usual.velocity, usual.acceleration * scale, usual.jerk * scale
        )

    def configuration(self) -> np.ndarray:
        model = self.robot.model
        return self.rng.uniform(model.lower, model.upper) * 0.6

    def efforts(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> np.ndarray:
        """Return efforts by the URDF, with the payload hung on its last joint."""
        model = self.robot.model
        arm = PinocchioArm(model)
        body = arm.body
        down = self.robot.base[:3, :3].T @ (0.0, 0.0, -9.80665)
        body.gravity = pinocchio.Motion(down, np.zeros(3))
        if self.dynamics_loaded:
            box = pinocchio.Inertia.FromBox(self.payload.mass, *self.payload.shape.size)
            place = pinocchio.SE3(model.flange @ self.payload.pose)
            body.appendBodyToJoint(body.njoints - 1, box, place)
        data = body.createData()
        rows = zip(q, v, a, strict=True)
        return np.array([pinocchio.rnea(body, data, *row).copy() for row in rows])

    @property
    def dynamics_loaded(self) -> bool:
        return self.payload.mass > 0.0

    @property
    def effort(self) -> np.ndarray:
        drives = self.robot.model.drives
        assert drives is not None
        return np.asarray(drives.effort)

    def worst(self, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> float:
        """Return the greatest share of its limit that any joint exerts."""
        return float(np.max(np.abs(self.efforts(q, v, a)) / self.effort))
