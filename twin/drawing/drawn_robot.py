"""A robot as its links, where they hang in the chain of joints, and the triangles that they show.

Shapes as triangles: round things smooth, meshes as they are.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio
from scipy.spatial import ConvexHull

from planning.cell.cover import box_body
from planning.cell.shape import Box, Capsule, Cylinder, Form, Mesh, Shape
from planning.cell.workcell import PlacedRobot
from planning.robots.descriptions.fitting import written_options
from planning.robots.registry import ROBOTS
from planning.transforms import Array, Indices, Transform
from twin.drawing.paint import painted_description

_SIDES = 48
"""Sides of what is round."""

_BENDS = 12
"""Rings of a half-sphere."""


@dataclass(frozen=True, eq=False)
class Triangles:
    """Triangles as they are drawn.

    Attributes:
        vertices: shape (v, 3) [m].
        normals: that light falls on, shape (v, 3).
        faces: shape (f, 3).
    """

    vertices: Array
    normals: Array
    faces: Indices


def triangles_of(shape: Shape) -> Triangles:
    """Return all that a shape is made of, in its frame."""
    parts = [(_triangles(element.form), element.pose) for element in shape.elements]
    first = np.cumsum([0, *(len(part.vertices) for part, _ in parts)])
    return Triangles(
        np.vstack([p.vertices @ at[:3, :3].T + at[:3, 3] for p, at in parts]),
        np.vstack([p.normals @ at[:3, :3].T for p, at in parts]),
        np.vstack(
            [p.faces + k for (p, _), k in zip(parts, first.tolist(), strict=False)]
        ),
    )


def corners_of_shape(shape: Shape) -> Array:
    """Return the corners of the triangles of all that a shape is made of, three rows each."""
    found = triangles_of(shape)
    return np.asarray(found.vertices[found.faces.reshape(-1)])


def corners_of(form: Form) -> Array:
    """Return the corners of a form's triangles, three rows each, shape (3 k, 3) [m]."""
    found = _triangles(form)
    return np.asarray(found.vertices[found.faces.reshape(-1)])


def _triangles(form: Form) -> Triangles:
    if isinstance(form, Mesh):
        return _flat(form.vertices, form.faces)
    if isinstance(form, Box):
        corners = box_body("box", form.size).vertices
        return _flat(
            corners, _outwards(corners, ConvexHull(corners).simplices.astype(np.int64))
        )
    return _turned(_profile(form))


def _flat(vertices: Array, faces: Indices) -> Triangles:
    """Return triangles each of which has corners of its own: their edges are seen."""
    corners = vertices[faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(across, axis=1, keepdims=True)
    across = across / np.maximum(length, 1e-300)
    count = 3 * len(faces)
    return Triangles(
        corners.reshape(-1, 3),
        np.repeat(across, 3, axis=0),
        np.arange(count, dtype=np.int64).reshape(-1, 3),
    )


def _outwards(vertices: Array, faces: Indices) -> Indices:
    """Return the faces of a hull around the origin, anticlockwise as seen from outside."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    inside = np.einsum("fx,fx->f", np.cross(b - a, c - a), a) < 0.0
    return np.where(inside[:, None], faces[:, ::-1], faces)


def _profile(form: Cylinder | Capsule) -> list[list[tuple[float, float, float, float]]]:
    """Return strips of what is turned about z: rings of radius and height, with their normals."""
    r, high = form.radius, 0.5 * form.length
    if isinstance(form, Cylinder):
        return [
            [(0.0, -high, 0.0, -1.0), (r, -high, 0.0, -1.0)],
            [(r, -high, 1.0, 0.0), (r, high, 1.0, 0.0)],
            [(r, high, 0.0, 1.0), (0.0, high, 0.0, 1.0)],
        ]
    up = [(np.cos(a), np.sin(a)) for a in np.linspace(0.0, 0.5 * np.pi, _BENDS)]
    rings = [(r * c, -high - r * s, c, -s) for c, s in reversed(up)]
    return [[*rings, *((r * c, high + r * s, c, s) for c, s in up)]]


def _turned(strips: list[list[tuple[float, float, float, float]]]) -> Triangles:
    angle = np.linspace(0.0, 2.0 * np.pi, _SIDES, endpoint=False)
    cos, sin, one = np.cos(angle), np.sin(angle), np.ones(_SIDES)
    vertices, normals, faces = [], [], []
    here = np.arange(_SIDES)
    there = (here + 1) % _SIDES
    count = 0
    for strip in strips:
        for out, high, aside, along in strip:
            vertices.append(np.column_stack([out * cos, out * sin, high * one]))
            normals.append(np.column_stack([aside * cos, aside * sin, along * one]))
        for low, top in pairwise(range(count, count + len(strip))):
            a, b = low * _SIDES, top * _SIDES
            faces.append(np.column_stack([a + here, a + there, b + there]))
            faces.append(np.column_stack([a + here, b + there, b + here]))
        count += len(strip)
    return Triangles(np.vstack(vertices), np.vstack(normals), np.vstack(faces))


Element = ElementTree.Element


@dataclass(frozen=True, eq=False)
class DrawnLink:
    """A link of a robot.

    Attributes:
        name: in the description.
        joint: number of the moved joints that move it, 0 for the base.
        pose: in the frame after the motion of the last of these joints, or of the base.
    """

    name: str
    joint: int
    pose: Transform


@dataclass(frozen=True, eq=False)
class DrawnBody:
    """A body that a link shows.

    Attributes:
        link: name of the link.
        corners: three rows a triangle, in the frame of the link, shape (3 k, 3) [m].
        colour: red, green, blue and opacity, 0 to 1.
    """

    link: str
    corners: Array
    colour: tuple[float, float, float, float]


@dataclass(frozen=True)
class DrawnRobot:
    """A robot as it is shown.

    Attributes:
        carriers: links whose frames are those of the base and after each moved joint.
        links: all others.
        bodies: what is seen.
    """

    carriers: tuple[str, ...]
    links: tuple[DrawnLink, ...]
    bodies: tuple[DrawnBody, ...]


def drawn_robot(robot: PlacedRobot, colour: tuple[int, int, int]) -> DrawnRobot:
    """Return a robot in its colour.

    Args:
        robot: the robot.
        colour: red, green and blue, 0 to 255.
    """
    tree = painted_description(robot, colour)
    _leave_out_lost(tree.getroot())
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "robot.urdf"
        tree.write(path)
        model, shown = _read(path, robot)
    links = []
    carriers = [""] * (robot.model.dof + 1)
    poses: dict[str, Transform] = {}
    for frame in model.frames:
        if frame.type != pinocchio.FrameType.BODY:
            continue
        pose = np.array(frame.placement.homogeneous)
        poses[frame.name] = pose
        joint = int(frame.parentJoint)
        if not carriers[joint] and np.array_equal(pose, np.eye(4)):
            carriers[joint] = frame.name
        else:
            links.append(DrawnLink(frame.name, joint, pose))
    bodies = []
    for item in shown.geometryObjects:
        link = model.frames[item.parentFrame].name
        own = np.linalg.solve(poses[link], np.array(item.placement.homogeneous))
        corners = _corners(item.geometry)
        rgba = tuple(np.asarray(item.meshColor, dtype=float).tolist())
        bodies.append(DrawnBody(link, corners @ own[:3, :3].T + own[:3, 3], rgba))
    return DrawnRobot(tuple(carriers), tuple(links), tuple(bodies))


def _read(path: Path, robot: PlacedRobot) -> tuple[Any, Any]:
    """Return model and shown geometry, with nothing but the moved joints left."""
    model = pinocchio.buildModelFromUrdf(str(path))
    kind = pinocchio.GeometryType.VISUAL
    shown = pinocchio.buildGeomFromUrdf(model, str(path), kind)
    moved = set(robot.model.joint_names)
    others = [name for name in model.names[1:] if name not in moved]
    if others:
        known = written_options(ElementTree.parse(path).getroot())
        held = (known or ROBOTS[robot.model.name]).frozen
        still = pinocchio.neutral(model)
        for name in others:
            still[model.joints[model.getJointId(name)].idx_q] = held[name]
        ids = [model.getJointId(name) for name in others]
        model, shown = pinocchio.buildReducedModel(model, shown, ids, still)
    return model, shown


def _leave_out_lost(root: Element) -> None:
    """Take out bodies whose mesh is in no file: the others can still be seen."""
    for link in root.findall("link"):
        for visual in link.findall("visual"):
            mesh = visual.find("geometry/mesh")
            if mesh is not None and not Path(mesh.get("filename", "")).is_file():
                link.remove(visual)


def _corners(shape: Any) -> Array:
    """Return the corners of the triangles of a shape of coal, shape (3 k, 3)."""
    kind = type(shape).__name__
    if kind == "Box":
        return corners_of(Box(tuple((2.0 * np.asarray(shape.halfSide)).tolist())))
    if kind == "Cylinder":
        return corners_of(Cylinder(float(shape.radius), 2.0 * float(shape.halfLength)))
    if kind == "Sphere":
        return corners_of(Capsule(float(shape.radius), 0.0))
    if kind == "Capsule":
        return corners_of(Capsule(float(shape.radius), 2.0 * float(shape.halfLength)))
    vertices = np.asarray(shape.vertices(), dtype=np.float64)
    faces = [shape.tri_indices(k) for k in range(shape.num_tris)]
    return np.asarray(vertices[[[f[0], f[1], f[2]] for f in faces]].reshape(-1, 3))
