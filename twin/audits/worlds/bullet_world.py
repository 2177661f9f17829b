"""A copy of the cell in PyBullet, for cross-checks of the audit with a library that the planner does not use.

Bullet adds a collision margin to every shape. The margin is set to zero for single shapes, and subtracted from the
distances of robot shapes. Distances of Bullet and coal on the same shapes then differ by at most 0.04 mm. This
was measured on boxes, cylinders and convex hulls of meshes, with overlaps up to 4 mm. In 1 of 3000 random
placements of overlapping hulls, the error of Bullet's penetration solver was larger.
"""

from __future__ import annotations

import tempfile
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Sequence
from itertools import combinations
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from planning.cell.robot_model import RobotModel
from planning.cell.shape import Box, Capsule, Cylinder
from planning.cell.workcell import PlacedRobot
from planning.errors import RobotModelError
from planning.robots.descriptions.xml_files import find_mesh
from planning.robots.registry import ROBOTS
from planning.silence import silence_output
from planning.transforms import Array, Transform, quat_wxyz
from twin.audits.worlds.world import (
    BASE,
    AuditWorld,
    Convex,
    WatchedShape,
    convex_forms,
)

with silence_output():  # prints a greeting to standard error
    import pybullet
    from pybullet_utils.bullet_client import BulletClient

MARGIN = 0.001
"""Margin that Bullet gives every shape of a URDF, which cannot be removed [m]."""

_INERTIAL = (
    '<inertial><mass value="1"/>'
    '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
)
"""Mass at the origin of a link: Bullet's frame of the link is then that of the URDF."""


class BulletWorld:
    """A PyBullet world without dynamics, for distances between bodies in given poses.

    Args:
        world: audit world with the same shapes; robots are loaded again from URDF files.

    Raises:
        RobotModelError: a description cannot be read, or has other joints.
    """

    def __init__(self, world: AuditWorld) -> None:
        with silence_output():  # prints its build options
            self._bullet = BulletClient(pybullet.DIRECT)
        # A description that changed on disk must not be taken from the cache.
        self._bullet.setPhysicsEngineParameter(enableFileCaching=0)
        cell = world.cell
        # Body of each robot, and Bullet's numbers of its moving joints.
        self._arms = [self._load(robot) for robot in cell.robots]
        links = [self._links_of(body) for body, _ in self._arms]
        # Bullet's numbers of body and link by number of the shape. Distances are those of whole links.
        self._known: dict[int, tuple[int, int]] = {}
        self._placed: dict[int, Transform] = {}
        for shape in world.robot_shapes:
            assert shape.robot is not None
            link = links[shape.robot][shape.detail.partition("/")[2]]
            self._known[shape.number] = self._arms[shape.robot][0], link
        made_of = [*(f.shape for f in cell.fixtures), *(o.shape for o in cell.objects)]
        forms = [form for shape in made_of for form, _ in convex_forms(shape)]
        for item, form in zip((*world.fixtures, *world.objects), forms, strict=True):
            self._known[item.number] = self._body(form), BASE
        for k, robot in enumerate(cell.robots):
            self.configure(k, robot.home)
        self._exempt = {
            (self._known[a.number], self._known[b.number])
            for a, b in combinations(world.robot_shapes, 2)
            if a.robot == b.robot and self.distance(a, b) <= 0.0
        }

    def close(self) -> None:
        """Disconnect from Bullet."""
        self._bullet.disconnect()

    def overlaps(
        self, pairs: Sequence[tuple[WatchedShape, WatchedShape]]
    ) -> Iterator[tuple[int, float]]:
        """Yield pairs of shapes with overlapping links, with their distance [m].

        Links of one robot that overlap at HOME are left out.
        """
        apart: dict[tuple[int, int], bool] = {}
        for k, (a, b) in enumerate(pairs):
            links = self._known[a.number], self._known[b.number]
            bodies = links[0][0], links[1][0]
            if bodies[0] != bodies[1] and bodies not in apart:
                apart[bodies] = not self._bullet.getClosestPoints(*bodies, 0.0)
            if not apart.get(bodies, False) and links not in self._exempt:
                distance = self.distance(a, b)
                if distance < 0.0:
                    yield k, distance

    def distance(self, a: WatchedShape, b: WatchedShape, reach: float = 0.0) -> float:
        """Return the signed distance of two shapes' links as they are placed now, at most reach [m]."""
        (body_a, link_a), (body_b, link_b) = (self._known[s.number] for s in (a, b))
        margin = MARGIN * ((a.robot is not None) + (b.robot is not None))
        points = self._bullet.getClosestPoints(body_a, body_b, reach, link_a, link_b)
        # With the margins added, the distance may be beyond reach.
        return float(min([reach, *(point[8] + margin for point in points)]))

    def place(self, item: WatchedShape, pose: Transform) -> None:
        """Pose a shape of a fixture or an object; the pose may not change afterwards."""
        if self._placed.get(item.number) is pose:
            return
        self._placed[item.number] = pose
        w, x, y, z = quat_wxyz(pose)
        self._bullet.resetBasePositionAndOrientation(
            self._known[item.number][0], pose[:3, 3].tolist(), [x, y, z, w]
        )

    def configure(self, robot: int, q: Array) -> None:
        """Put a robot at a configuration, shape (n,)."""
        body, moved = self._arms[robot]
        values = [[value] for value in q.tolist()]
        self._bullet.resetJointStatesMultiDof(body, moved, values)

    def hand(self, robot: int) -> Transform:
        """Return the pose of a robot's last link, shape (4, 4)."""
        out, (body, moved) = np.eye(4), self._arms[robot]
        state = self._bullet.getLinkState(body, moved[-1], 0, 1)
        out[:3, 3] = state[4]
        out[:3, :3] = Rotation.from_quat(state[5]).as_matrix()
        return out

    def _load(self, robot: PlacedRobot) -> tuple[int, list[int]]:
        """Load a robot, fixed at its base; return its body and the joints that move."""
        model, (w, x, y, z) = robot.model, quat_wxyz(robot.base)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "robot.urdf")
            path.write_text(_description(model))
            body: int = self._bullet.loadURDF(
                str(path),
                robot.base[:3, 3].tolist(),
                [x, y, z, w],
                useFixedBase=1,
                flags=pybullet.URDF_USE_IMPLICIT_CYLINDER,
            )
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
        return body, [joints[name] for name in model.joint_names]

    def _links_of(self, body: int) -> dict[str, int]:
        """Return Bullet's numbers of a robot's links by name."""
        count = self._bullet.getNumJoints(body)
        infos = [self._bullet.getJointInfo(body, j) for j in range(count)]
        root = self._bullet.getBodyInfo(body)[0].decode()
        return {root: BASE, **{info[12].decode(): j for j, info in enumerate(infos)}}

    def _body(self, form: Convex) -> int:
        """Load a form that is centred at the origin; return the number of its body."""
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
        body: int = self._bullet.createMultiBody(0, number)
        # Round forms keep a part of their margin, which Bullet takes into account when it measures.
        self._bullet.changeDynamics(body, BASE, collisionMargin=0.0)
        return body


def _description(model: RobotModel) -> str:
    """Return a robot's URDF for Bullet, with absolute file names and enlarged shapes.

    Bullet inflates the hulls of meshes by its margin, but rounds the edges of boxes and cylinders off
    within them. Boxes and cylinders are therefore enlarged by the margin: Bullet then measures the
    distance of the sharp form less the margin, as for hulls. Bullet takes the radius of a sphere as
    its margin; spheres are enlarged, too.
    """
    try:
        robot = ElementTree.parse(model.urdf).getroot()
    except (OSError, ElementTree.ParseError) as error:
        raise RobotModelError(f"cannot read {model.urdf}: {error}") from error
    for link in robot.findall("link"):
        for part in (*link.findall("visual"), *link.findall("inertial")):
            link.remove(part)
        link.append(ElementTree.fromstring(_INERTIAL))
        for geometry in link.findall("collision/geometry"):
            for form in geometry:
                for key in ("size", "radius", "length"):
                    if key in form.attrib:
                        grown = MARGIN if key == "radius" else 2.0 * MARGIN
                        sizes = map(float, form.attrib[key].split())
                        form.set(key, " ".join(repr(s + grown) for s in sizes))
            mesh = geometry.find("mesh")
            if mesh is not None:
                name = str(mesh.get("filename"))
                found = find_mesh(name, model.package_dirs)
                if found is None:
                    raise RobotModelError(
                        f"{model.urdf}: mesh {name!r} was not found",
                        choices=tuple(map(str, model.package_dirs)),
                    )
                mesh.set("filename", str(found.resolve()))
    # Bullet splits lines longer than 8 kB, even within a word; indenting makes them short.
    ElementTree.indent(robot)
    return ElementTree.tostring(robot, encoding="unicode")
