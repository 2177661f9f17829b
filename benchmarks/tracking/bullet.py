"""Worlds of PyBullet, and how robots get into them."""

from __future__ import annotations

import tempfile
import xml.etree.ElementTree as ElementTree
from pathlib import Path

from benchmarks.tracking.described_robot import DescribedRobot
from planning.silence import silenced
from planning.transforms import quat_wxyz

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
