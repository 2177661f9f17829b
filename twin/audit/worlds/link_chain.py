"""Robots as libraries read their descriptions: joints of pinocchio, and poses of links from a few that an engine measured.

An engine says where the links are at a few configurations and along which axes its joints move;
from that follow all others, many at a time. Where they do not follow, because a joint does not
carry the next one, the robot is left to the engine, one configuration after another.

A URDF rewritten so that every collision shape is measured on its own, and exactly.

Every shape becomes a link of its own, so that distances are those of single convex shapes.

Bullet gives every shape of a URDF a margin of 1 mm that cannot be taken away. It inflates the
hulls of meshes by it, and rounds the edges of boxes and cylinders off with it. So for Bullet
boxes and cylinders are made larger by 1 mm here: what it then measures is the distance of the
sharp shape less 1 mm, for them as for hulls.
"""

from __future__ import annotations

import copy
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pinocchio

from planning.cell.robot_model import RobotModel
from planning.errors import RobotModelError
from planning.robots.descriptions.xml_files import find_mesh
from planning.robots.registry import ROBOTS
from planning.transforms import Array


@dataclass(frozen=True)
class JointAxes:
    """The axes of a robot's joints.

    Attributes:
        direction: in the frame of the link that the joint moves, shape (n, 3).
        prismatic: shape (n,).
    """

    direction: Array
    prismatic: npt.NDArray[np.bool_]


Frames = tuple[Array, Array]
"""Rotations, shape (m, n + 1, 3, 3), and positions, shape (m, n + 1, 3): base, then links."""

_SAME = 1e-6
"""Links are where the engine puts them to within this [m per metre, and entries of rotations]:
Bullet rounds rotations by less than half of it."""

_TRIED = 16
"""Random configurations from which the chain is read off."""


@dataclass(frozen=True)
class LinkChain:
    """A robot whose joints follow one another, as an engine has measured it.

    Attributes:
        axes: of its joints.
        base: rotation and position of its base, shapes (3, 3) and (3,).
        turns: rotation of each link as seen from the one before, all joints at nought, shape
            (n, 3, 3).
        offsets: position likewise, shape (n, 3) [m].
    """

    axes: JointAxes
    base: tuple[Array, Array]
    turns: Array
    offsets: Array

    def frames(self, q: Array) -> Frames:
        """Return where the base and the links are at configurations, shape (m, n)."""
        count = len(self.offsets)
        rotation = np.empty((len(q), count + 1, 3, 3))
        position = np.empty((len(q), count + 1, 3))
        rotation[:, 0], position[:, 0] = self.base
        for j in range(count):
            before, axis = rotation[:, j], self.axes.direction[j]
            turn = before @ self.turns[j]
            position[:, j + 1] = position[:, j] + before @ self.offsets[j]
            if self.axes.prismatic[j]:
                position[:, j + 1] += (turn @ axis) * q[:, j, None]
                rotation[:, j + 1] = turn
            else:
                rotation[:, j + 1] = turn @ _turned(axis, q[:, j])
        return rotation, position


def measured_chain(
    axes: JointAxes, base: tuple[Array, Array], measure: Callable[[Array], Frames]
) -> LinkChain | None:
    """Return the chain of a robot, None where its joints do not follow one another.

    Args:
        axes: of its joints.
        base: rotation and position of its base.
        measure: returns what the engine says of configurations, shape (m, n).
    """
    count = len(axes.prismatic)
    tried = np.random.default_rng(0).uniform(-2.0, 2.0, (_TRIED, count))
    rotation, position = measure(tried)
    turns, offsets = np.empty((count, 3, 3)), np.empty((count, 3))
    for j in range(count):
        axis, back = axes.direction[j], rotation[:, j].transpose(0, 2, 1)
        turn = back @ rotation[:, j + 1]
        if not axes.prismatic[j]:
            turn = turn @ _turned(axis, -tried[:, j])
        turns[j] = _nearest_rotation(turn.mean(axis=0))
        way = np.einsum("mab,mb->ma", back, position[:, j + 1] - position[:, j])
        if axes.prismatic[j]:
            way = way - tried[:, j, None] * (turns[j] @ axis)
        offsets[j] = way.mean(axis=0)
    chain = LinkChain(axes, base, turns, offsets)
    own_rotation, own_position = chain.frames(tried)
    size = 1.0 + float(np.abs(position - position[:, :1]).max())
    same = (
        np.abs(own_rotation - rotation).max() <= _SAME
        and np.abs(own_position - position).max() <= _SAME * size
    )
    return chain if same else None


def _nearest_rotation(matrix: Array) -> Array:
    """Return the rotation that is nearest to a matrix, shape (3, 3)."""
    left, _, right = np.linalg.svd(matrix)
    return np.asarray(left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right)


def _turned(axis: Array, angle: Array) -> Array:
    """Return rotations about a unit axis, shape (m, 3, 3)."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sine, rest = np.sin(angle)[:, None, None], 1.0 - np.cos(angle)[:, None, None]
    return np.asarray(np.eye(3) + sine * cross + rest * (cross @ cross))


@dataclass(frozen=True)
class ShapeLink:
    """A link that carries one collision shape.

    Attributes:
        link: name of the new link.
        owner: link of the original description that the shape belongs to.
        margin: by how much it is measured too large [m].
    """

    link: str
    owner: str
    margin: float


def one_shape_a_link(
    urdf: Path, package_dirs: Sequence[Path], margin: float
) -> tuple[str, tuple[ShapeLink, ...]]:
    """Return the rewritten description and the links that carry its shapes.

    Every collision shape becomes a link of its own, fixed to the link it came from. Visual
    shapes and inertias are left out: the audit looks at positions only.

    Args:
        urdf: the description.
        package_dirs: where meshes are looked up.
        margin: that the collision library gives every shape [m].

    Raises:
        RobotModelError: the file cannot be read, or a mesh is not there.
    """
    try:
        robot = ElementTree.parse(urdf).getroot()
    except (OSError, ElementTree.ParseError) as error:
        raise RobotModelError(f"cannot read {urdf}: {error}") from error
    shapes: list[ShapeLink] = []
    for link in robot.findall("link"):
        owner = str(link.get("name"))
        collisions = link.findall("collision")
        for child in list(link):
            link.remove(child)
        link.append(_unit_inertia())
        for number, collision in enumerate(collisions):
            inflated = _prepare(collision, urdf, package_dirs, margin)
            name = f"{owner}//{number}"
            shapes.append(ShapeLink(name, owner, inflated))
            robot.append(_shape_link(name, collision))
            robot.append(_mount(name, owner, collision.find("origin")))
    # Bullet breaks lines of more than 8 kB, in the midst of a word.
    ElementTree.indent(robot)
    return ElementTree.tostring(robot, encoding="unicode"), tuple(shapes)


def _prepare(
    collision: ElementTree.Element,
    urdf: Path,
    package_dirs: Sequence[Path],
    margin: float,
) -> float:
    """Grow a shape by the margin or complete its file name; return how far it is inflated."""
    box = collision.find("geometry/box")
    if box is not None:
        size = [float(s) + 2 * margin for s in str(box.get("size")).split()]
        box.set("size", " ".join(map(repr, size)))
    cylinder = collision.find("geometry/cylinder")
    if cylinder is not None:
        cylinder.set("radius", repr(float(str(cylinder.get("radius"))) + margin))
        cylinder.set("length", repr(float(str(cylinder.get("length"))) + 2 * margin))
    mesh = collision.find("geometry/mesh")
    if mesh is not None:
        name = str(mesh.get("filename"))
        found = find_mesh(name, package_dirs)
        if found is None:
            choices = tuple(map(str, package_dirs))
            raise RobotModelError(
                f"{urdf}: mesh {name!r} was not found", choices=choices
            )
        mesh.set("filename", str(found.resolve()))
    # A sphere is a point with its radius for a margin: nothing to make up for.
    return 0.0 if collision.find("geometry/sphere") is not None else margin


def _shape_link(name: str, collision: ElementTree.Element) -> ElementTree.Element:
    link = ElementTree.Element("link", name=name)
    link.append(_unit_inertia())
    at_origin = ElementTree.SubElement(link, "collision")
    geometry = collision.find("geometry")
    if geometry is not None:
        at_origin.append(copy.deepcopy(geometry))
    return link


def _mount(
    name: str, owner: str, origin: ElementTree.Element | None
) -> ElementTree.Element:
    joint = ElementTree.Element("joint", name=f"{name}//mount", type="fixed")
    ElementTree.SubElement(joint, "parent", link=owner)
    ElementTree.SubElement(joint, "child", link=name)
    if origin is not None:
        joint.append(copy.deepcopy(origin))
    return joint


def _unit_inertia() -> ElementTree.Element:
    """Return an inertia at the link's origin: Bullet's link frame is then the URDF's."""
    inertial = ElementTree.Element("inertial")
    ElementTree.SubElement(inertial, "mass", value="1")
    ones = {"ixx": "1", "iyy": "1", "izz": "1", "ixy": "0", "ixz": "0", "iyz": "0"}
    ElementTree.SubElement(inertial, "inertia", ones)
    return inertial


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
