"""Controllers of joints at 1 kHz, within effort limits: computed torque, and each joint on its own."""

import xml.etree.ElementTree as ElementTree
from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np

from benchmarks.tracking.described_robot import PLACE, DescribedRobot, Payload
from benchmarks.tracking.plant import load_body, new_world, without_shapes
from planning.transforms import Array

PERIOD_S = 0.001
BANDWIDTH = 100.0
"""Of the loop around each joint: three equal poles [rad/s]."""


class Controller(ABC):
    """A PID on the error of each joint, around the commanded acceleration; close it after use.

    A joint at its effort limit does not integrate its error.

    Args:
        robot: what the controller believes of it; its base stands upright.
        bandwidth: of the loop [rad/s].

    Raises:
        ValueError: the base is tilted, which Bullet's inverse dynamics do not know.
    """

    def __init__(self, robot: DescribedRobot, bandwidth: float = BANDWIDTH) -> None:
        if not np.allclose(robot.base[2, :3], [0.0, 0.0, 1.0], atol=1e-9):
            raise ValueError(f"{robot.name}: the base is tilted")
        self._robot = robot
        self._gains = 3 * bandwidth**2, 3 * bandwidth, bandwidth**3
        self._effort = np.array(robot.effort)
        self._integral = np.zeros(len(robot.joints))
        self._bullet = new_world()
        # A body for each load: Bullet keeps the inverse dynamics of a body as they were at first.
        self._known: dict[frozenset[Payload], int] = {}
        self._inverse = self._bullet.calculateInverseDynamics
        self.hold(frozenset())

    def close(self) -> None:
        """Disconnect from Bullet."""
        self._bullet.disconnect()

    def hold(self, payloads: frozenset[Payload]) -> None:
        """Take note of what is in hand."""
        if payloads not in self._known:
            loaded = without_shapes(_loaded(self._robot.urdf, payloads))
            self._known[payloads] = load_body(self._bullet, self._robot, loaded)
        self._body = self._known[payloads]

    def torque(
        self, command: Sequence[Array], state: Sequence[Array]
    ) -> tuple[Array, Array]:
        """Return the torques to apply, and those that it would take without effort limits.

        Args:
            command: configuration, speeds and accelerations that are commanded.
            state: configuration and speeds as measured.
        """
        proportional, derivative, integral = self._gains
        error = command[0] - state[0]
        acceleration = (
            command[2]
            + proportional * error
            + derivative * (command[1] - state[1])
            + integral * self._integral
        )
        wanted = self._needed(state[0], state[1], acceleration)
        torque = np.clip(wanted, -self._effort, self._effort)
        self._integral += np.where(torque == wanted, error * PERIOD_S, 0.0)
        return torque, wanted

    def inverse_dynamics(self, q: Array, v: Array, a: Array) -> Array:
        """Return the torques that the description says an acceleration takes, shape (n,)."""
        found = self._inverse(self._body, q.tolist(), v.tolist(), a.tolist())
        return np.array(found)

    @abstractmethod
    def _needed(self, q: Array, v: Array, a: Array) -> Array:
        """Return the torques for an acceleration, as far as the controller knows."""


class ComputedTorque(Controller):
    """Torques by the inverse dynamics of the description, with the part in hand."""

    def _needed(self, q: Array, v: Array, a: Array) -> Array:
        return self.inverse_dynamics(q, v, a)


class JointByJoint(Controller):
    """Each joint on its own, with the inertia and the gravity that it has where the robot starts."""

    _start: tuple[Array, Array] | None = None

    def _needed(self, q: Array, v: Array, a: Array) -> Array:
        if self._start is None:
            still = np.zeros(len(q))
            gravity = self.inverse_dynamics(q, still, still)
            columns = [
                self.inverse_dynamics(q, still, unit) - gravity
                for unit in np.eye(len(q))
            ]
            self._start = gravity, np.diag(np.array(columns)).copy()
        gravity, inertia = self._start
        return np.asarray(gravity + inertia * a)


def _loaded(urdf: str, payloads: frozenset[Payload]) -> str:
    """Return a description with parts at their places."""
    root = ElementTree.fromstring(urdf)
    for payload in payloads:
        inertial = root.find(f"link[@name='{PLACE}{payload.place}']/inertial")
        assert inertial is not None
        mass, inertia = inertial.find("mass"), inertial.find("inertia")
        assert mass is not None
        assert inertia is not None
        mass.set("value", repr(payload.mass))
        for key, value in zip(("ixx", "iyy", "izz"), payload.inertia, strict=True):
            inertia.set(key, repr(value))
    return ElementTree.tostring(root, encoding="unicode")
