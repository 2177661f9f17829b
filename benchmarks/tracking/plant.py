"""Robots in PyBullet's dynamics: torques in, positions and speeds out.

Each joint turns as Featherstone's algorithm says, under gravity, with the masses and inertias of the
description and those of parts in hand. Nothing touches anything: robots have no shapes here, and a part
is a mass at its place on the tool from when it is picked until it is put down.

Worlds of PyBullet, and how robots get into them.
"""

import tempfile
import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.tracking.described_robot import PLACE, DescribedRobot, Payload
from planning.silence import silenced
from planning.transforms import Array, quat_wxyz

with silenced():  # it greets on standard error
    import pybullet
    from pybullet_utils.bullet_client import BulletClient

GRAVITY = 9.81
TORQUE_CONTROL: int = pybullet.TORQUE_CONTROL
VELOCITY_CONTROL: int = pybullet.VELOCITY_CONTROL

# Without a word Bullet makes up inertias from shapes, and prisms of cylinders.
_FLAGS = pybullet.URDF_USE_INERTIA_FROM_FILE | pybullet.URDF_USE_IMPLICIT_CYLINDER


def new_world() -> BulletClient:
    """Return an empty world with gravity; disconnect it after use."""
    with silenced():  # it tells its options
        bullet = BulletClient(pybullet.DIRECT)
    bullet.setGravity(0.0, 0.0, -GRAVITY)
    return bullet


def without_shapes(urdf: str) -> str:
    """Return a description without anything to see or to touch."""
    root = ElementTree.fromstring(urdf)
    for link in root.findall("link"):
        for shape in (*link.findall("visual"), *link.findall("collision")):
            link.remove(shape)
    return ElementTree.tostring(root, encoding="unicode")


def load_body(bullet: BulletClient, robot: DescribedRobot, urdf: str) -> int:
    """Load a robot, fixed at its base, from a text with the inertias that it states."""
    w, x, y, z = quat_wxyz(robot.base)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "robot.urdf")
        path.write_text(urdf, encoding="utf-8")
        with silenced():
            number: int = bullet.loadURDF(
                str(path),
                robot.base[:3, 3].tolist(),
                [x, y, z, w],
                useFixedBase=1,
                flags=_FLAGS,
            )
    return number


STEP_S = 0.0005
"""Of the integration [s]."""


@dataclass(frozen=True)
class Flaws:
    """What a plant has that its controllers do not know of.

    Attributes:
        heavier: share by which links and parts are heavier, and have more inertia.
        friction: dry friction of the joints of each robot, shape (n,) each [N m or N]; none where
            it is empty.
    """

    heavier: float = 0.0
    friction: tuple[Array, ...] = ()


@dataclass
class _Body:
    """A robot in Bullet: its number, its driven joints, and the links at which it holds parts."""

    number: int
    joints: list[int]
    places: dict[int, int]


class Plant:
    """All robots of a cell in one world; close it after use.

    Args:
        robots: what they are.
        flaws: what is not as described.
    """

    def __init__(
        self,
        robots: Sequence[DescribedRobot],
        flaws: Flaws = Flaws(),
    ) -> None:
        self._flaws = flaws
        self._bullet = new_world()
        self._bullet.setTimeStep(STEP_S)
        self._bodies = [self._load(k, robot) for k, robot in enumerate(robots)]
        # Looked up once: the client makes a function anew whenever it is asked for one.
        self._states = self._bullet.getJointStates
        self._drive = self._bullet.setJointMotorControlArray
        self._step = self._bullet.stepSimulation

    def close(self) -> None:
        """Disconnect from Bullet."""
        self._bullet.disconnect()

    def _load(self, index: int, robot: DescribedRobot) -> _Body:
        bullet = self._bullet
        number = load_body(bullet, robot, without_shapes(robot.urdf))
        body = _Body(number, [], {})
        by_name = {}
        for link in range(-1, bullet.getNumJoints(number)):
            mass, _, inertia, *_ = bullet.getDynamicsInfo(number, link)
            more = 1.0 + self._flaws.heavier
            bullet.changeDynamics(
                number,
                link,
                mass=mass * more,
                localInertiaDiagonal=[value * more for value in inertia],
                linearDamping=0.0,
                angularDamping=0.0,
                jointDamping=0.0,
            )
            if link >= 0:
                name = bullet.getJointInfo(number, link)[1].decode()
                by_name[name] = link
                if name.startswith(PLACE):
                    body.places[int(name.removeprefix(PLACE))] = link
        body.joints = [by_name[name] for name in robot.joints]
        friction = np.zeros(len(body.joints))
        if self._flaws.friction:
            friction = self._flaws.friction[index]
        for joint, most in zip(body.joints, friction.tolist(), strict=True):
            # The motor that Bullet gives each joint is dry friction when it is told to stand.
            bullet.setJointMotorControl2(
                number, joint, VELOCITY_CONTROL, targetVelocity=0.0, force=most
            )
        return body

    def put(self, robot: int, q: Array, v: Array) -> None:
        """Put a robot into a state, both of shape (n,)."""
        body = self._bodies[robot]
        self._bullet.resetJointStatesMultiDof(
            body.number,
            body.joints,
            [[value] for value in q.tolist()],
            [[value] for value in v.tolist()],
        )

    def state(self, robot: int) -> tuple[Array, Array]:
        """Return the configuration and the speeds of a robot, both of shape (n,)."""
        body = self._bodies[robot]
        found = self._states(body.number, body.joints)
        return np.array([s[0] for s in found]), np.array([s[1] for s in found])

    def carry(self, robot: int, payload: Payload, holds: bool) -> None:
        """Put a part into the hand of a robot, or take it away."""
        body = self._bodies[robot]
        more = (1.0 + self._flaws.heavier) * holds
        self._bullet.changeDynamics(
            body.number,
            body.places[payload.place],
            mass=payload.mass * more,
            localInertiaDiagonal=[value * more for value in payload.inertia],
        )

    def advance(self, torques: Sequence[Array], steps: int) -> None:
        """Advance by some steps, with the same torques [N m or N] for each robot throughout."""
        for _ in range(steps):
            for body, torque in zip(self._bodies, torques, strict=True):
                self._drive(
                    body.number,
                    body.joints,
                    TORQUE_CONTROL,
                    forces=torque.tolist(),
                )
            self._step()
