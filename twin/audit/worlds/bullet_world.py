"""The audit's own copy of the cell in PyBullet: robots from their URDF files, forms for the rest.

Distances of Bullet and of coal on the same shapes differ by at most 0.04 mm (measured on boxes,
cylinders, and hulls of meshes, up to 4 mm deep), once margins are made up for: that of single
boxes is set to zero, that of the shapes of robots is added to what Bullet reports. When hulls
overlap, Bullet's penetration solver was wrong by more than that at 1 of 3000 random placements;
neighbouring samples of a motion do not share such a slip.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from planning.cell.shape import Box, Capsule, Cylinder
from planning.cell.workcell import PlacedRobot, Workcell
from planning.errors import RobotModelError
from planning.robots.registry import ROBOTS
from planning.silence import silenced
from planning.transforms import Array, Transform, quat_wxyz
from twin.audit.worlds.link_chain import Frames, JointAxes, ShapeLink
from twin.audit.worlds.world import BASE, AuditWorld, Convex, JointLimits, WatchedShape

with silenced():  # it greets on standard error
    import pybullet
    from pybullet_utils.bullet_client import BulletClient

MARGIN = 0.001
"""Bullet's margin of the shapes of a URDF [m]."""


class BulletWorld(AuditWorld):
    """A PyBullet world without dynamics, for distances between bodies that are posed.

    Args:
        cell: what to load.
    """

    margin = MARGIN

    def __init__(self, cell: Workcell) -> None:
        with silenced():  # it tells its options
            self._bullet = BulletClient(pybullet.DIRECT)
        # A description that changed on disk must not be taken from the cache.
        self._bullet.setPhysicsEngineParameter(enableFileCaching=0)
        # Bullet's numbers of body and link of each shape, and by how much it inflates it [m].
        self._known: list[tuple[int, int, float]] = []
        self._placed: dict[int, Transform] = {}
        # Looked up once: the client makes a function anew whenever it is asked for one.
        self._set_joints = self._bullet.resetJointStatesMultiDof
        self._set_pose = self._bullet.resetBasePositionAndOrientation
        self._closest = self._bullet.getClosestPoints
        # Of each robot its body, and Bullet's numbers of the joints that move and of all links.
        self._bodies: list[int] = []
        self._moved: list[list[int]] = []
        self._links: list[dict[str, int]] = []
        super().__init__(cell)

    def close(self) -> None:
        """Disconnect from Bullet."""
        self._bullet.disconnect()

    def _load(self, robot: PlacedRobot, text: str) -> tuple[JointAxes, JointLimits]:
        model, body = robot.model, self._urdf_body(text, robot.base)
        count = self._bullet.getNumJoints(body)
        infos = [self._bullet.getJointInfo(body, j) for j in range(count)]
        joints = {info[1].decode(): j for j, info in enumerate(infos)}
        missing = [name for name in model.joint_names if name not in joints]
        if missing:
            raise RobotModelError(
                f"{model.urdf} has no joint {missing[0]!r}", choices=tuple(joints)
            )
        entry = ROBOTS.get(model.name)
        for name, value in (entry.frozen if entry else {}).items():
            self._bullet.resetJointState(body, joints[name], value)
        moved = [joints[name] for name in model.joint_names]
        self._bodies.append(body)
        self._moved.append(moved)
        self._links.append({info[12].decode(): j for j, info in enumerate(infos)})
        own = [infos[j] for j in moved]
        slides = np.array([info[2] == pybullet.JOINT_PRISMATIC for info in own])
        lower, upper, speed = np.array([(i[8], i[9], i[11]) for i in own]).T
        # Bullet says of a continuous joint that its range is empty.
        free = lower > upper
        limits = JointLimits(
            model.joint_names,
            np.where(free, -np.inf, lower),
            np.where(free, np.inf, upper),
            speed,
            tuple("m" if slide else "rad" for slide in slides),
        )
        return JointAxes(np.array([info[13] for info in own]), slides), limits

    def _link(
        self, robot: int, link: ShapeLink, entity: str, detail: str
    ) -> WatchedShape:
        body, moved = self._bodies[robot], self._moved[robot]
        number = carrier = self._links[robot][link.link]
        while carrier != BASE and carrier not in moved:
            carrier = self._bullet.getJointInfo(body, carrier)[16]
        joint = moved.index(carrier) if carrier != BASE else BASE
        zero = np.zeros(len(moved))
        rotation, position = self._measured(robot, zero[None])
        low, high = np.array(self._bullet.getAABB(body, number))
        turn, half = rotation[0, joint + 1].T, 0.5 * (high - low)
        centre = turn @ (0.5 * (low + high) - position[0, joint + 1])
        radius = float(np.linalg.norm(half))
        known = self._know(body, number, link.margin)
        around = centre, radius, half, turn
        return WatchedShape(entity, detail, known, robot, joint, *around)

    def _know(self, body: int, link: int, margin: float) -> int:
        self._known.append((body, link, margin))
        return len(self._known) - 1

    def _urdf_body(self, text: str, base: Transform) -> int:
        """Load a description, fixed at a pose; return Bullet's number for it."""
        w, x, y, z = quat_wxyz(base)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "robot.urdf")
            path.write_text(text)
            body: int = self._bullet.loadURDF(
                str(path),
                base[:3, 3].tolist(),
                [x, y, z, w],
                useFixedBase=1,
                flags=pybullet.URDF_USE_IMPLICIT_CYLINDER,
            )
        return body

    def _body(self, form: Convex) -> int:
        create = self._bullet.createCollisionShape
        if isinstance(form, Box):
            half = [0.5 * edge for edge in form.size]
            number = create(pybullet.GEOM_BOX, halfExtents=half)
        elif isinstance(form, Cylinder):
            number = create(
                pybullet.GEOM_CYLINDER, radius=form.radius, height=form.length
            )
        elif isinstance(form, Capsule) and form.length == 0.0:
            number = create(pybullet.GEOM_SPHERE, radius=form.radius)
        elif isinstance(form, Capsule):
            number = create(
                pybullet.GEOM_CAPSULE, radius=form.radius, height=form.length
            )
        else:
            number = create(pybullet.GEOM_MESH, vertices=form.tolist())
        body = self._bullet.createMultiBody(0, number)
        # What is left of the margins of round forms is made up for when they are measured.
        self._bullet.changeDynamics(body, BASE, collisionMargin=0.0)
        return self._know(body, BASE, 0.0)

    def place(self, item: WatchedShape, pose: Transform) -> None:
        """Pose a shape of a fixture or an object."""
        if self._placed.get(item.number) is pose:
            return
        self._placed[item.number] = pose
        w, x, y, z = quat_wxyz(pose)
        self._set_pose(self._known[item.number][0], pose[:3, 3].tolist(), [x, y, z, w])

    def configure(self, robot: int, q: Array) -> None:
        """Put a robot at a configuration, shape (n,)."""
        values = [[value] for value in q.tolist()]
        self._set_joints(self._bodies[robot], self._moved[robot], values)

    def _measured(self, robot: int, q: Array) -> Frames:
        body, moved = self._bodies[robot], self._moved[robot]
        states = np.empty((len(q), len(moved), 7))
        for k, row in enumerate(q):
            self.configure(robot, row)
            found = self._bullet.getLinkStates(body, moved, computeForwardKinematics=1)
            states[k] = [s[4] + s[5] for s in found]
        base = self.cell.robots[robot].base
        position = np.empty((len(q), len(moved) + 1, 3))
        rotation = np.empty((len(q), len(moved) + 1, 3, 3))
        position[:, 0], rotation[:, 0] = base[:3, 3], base[:3, :3]
        position[:, 1:] = states[:, :, :3]
        turned = Rotation.from_quat(states[:, :, 3:].reshape(-1, 4)).as_matrix()
        rotation[:, 1:] = turned.reshape(len(q), -1, 3, 3)
        return rotation, position

    def distance(self, a: WatchedShape, b: WatchedShape, reach: float) -> float:
        """Return the signed distance of two shapes as they are placed now [m]."""
        body_a, link_a, margin_a = self._known[a.number]
        body_b, link_b, margin_b = self._known[b.number]
        margin = margin_a + margin_b
        points = self._closest(body_a, body_b, reach, link_a, link_b)
        # What is nearer before margins are made up for may be beyond reach.
        return float(min([reach, *(point[8] + margin for point in points)]))
