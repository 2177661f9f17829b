"""What things look like: shapes as triangles, round things smooth, meshes as they are; fixtures in colours.

A robot as its links, where they hang in the chain of joints, and the triangles that they show. Each of a
team is painted in its own colour, so that they can be told apart, with nothing left out.
"""

from __future__ import annotations

import copy
import tempfile
from collections.abc import Iterable, Iterator
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
from planning.cell.workcell import Fixture, PlacedRobot, Workcell
from planning.robots.descriptions.fitting import written_options
from planning.robots.descriptions.xml_files import find_mesh
from planning.robots.registry import ROBOTS
from planning.transforms import Array, Indices, Transform

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


def corners_of(shape: Shape | Form) -> Array:
    """Return the corners of triangles, three rows each, shape (3 k, 3) [m].

    Args:
        shape: whose, all that it is made of; or one form.
    """
    found = triangles_of(shape) if isinstance(shape, Shape) else _triangles(shape)
    return np.asarray(found.vertices[found.faces.reshape(-1)])


def _triangles(form: Form) -> Triangles:
    if isinstance(form, Mesh):
        return _flat(form.vertices, form.faces)
    if isinstance(form, Box):
        corners = box_body("box", form.size).vertices
        faces = ConvexHull(corners).simplices.astype(np.int64)
        # Anticlockwise as seen from outside; the origin is within.
        a, b, c = (corners[faces[:, k]] for k in range(3))
        inside = np.einsum("fx,fx->f", np.cross(b - a, c - a), a) < 0.0
        return _flat(corners, np.where(inside[:, None], faces[:, ::-1], faces))
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
    if kind in ("Cylinder", "Capsule", "Sphere"):
        length = 2.0 * float(getattr(shape, "halfLength", 0.0))
        turned = Cylinder if kind == "Cylinder" else Capsule
        return corners_of(turned(float(shape.radius), length))
    vertices = np.asarray(shape.vertices(), dtype=np.float64)
    faces = [shape.tri_indices(k) for k in range(shape.num_tris)]
    return np.asarray(vertices[[[f[0], f[1], f[2]] for f in faces]].reshape(-1, 3))


_PAINTED = 0.6
"""Parts of a robot as saturated as this are painted in the team's colour."""

_LIGHT = 0.75
"""Meshes with all channels as light as this are tinted by it."""

_TINT = 0.55
"""Share of the team's colour in the tint."""

_WHITE = (1.0, 1.0, 1.0)


def paint(
    urdf: ElementTree.Element, colour: tuple[int, int, int], *, linear: bool = False
) -> None:
    """Give a robot its colour: what is coloured takes it, white meshes are tinted.

    Parts that are grey or black stay as they are.

    Args:
        urdf: root of the description, changed in place.
        colour: red, green and blue, 0 to 255.
        linear: write the intensities that the colour stands for, as some viewers take it.
    """

    def rgba(channels: Iterable[float]) -> str:
        shades = [round(channel, 4) for channel in channels]
        return " ".join(f"{_linear(c) if linear else c:.4f}" for c in shades) + " 1"

    coats = {
        material.get("name"): channels
        for material in urdf.iter("material")
        if (channels := _channels(material)) is not None
    }
    full = rgba(c / 255.0 for c in colour)
    tint = rgba(1.0 - _TINT * (1.0 - c / 255.0) for c in colour)
    for visual in urdf.iter("visual"):
        material = visual.find("material")
        own = None if material is None else _channels(material)
        if own is None and material is not None:
            own = coats.get(material.get("name"))
        if own is not None and _saturation(own) >= _PAINTED:
            _coat(visual, "team", full)
        elif visual.find("geometry/mesh") is not None and min(own or _WHITE) >= _LIGHT:
            _coat(visual, "team-tint", tint)


def _linear(channel: float) -> float:
    """Return the intensity that a channel, 0 to 1, stands for."""
    return channel / 12.92 if channel <= 0.04045 else ((channel + 0.055) / 1.055) ** 2.4


def _coat(visual: ElementTree.Element, name: str, rgba: str) -> None:
    for material in visual.findall("material"):
        visual.remove(material)
    coat = ElementTree.SubElement(visual, "material", name=name)
    ElementTree.SubElement(coat, "color", rgba=rgba)


def _channels(material: ElementTree.Element) -> tuple[float, ...] | None:
    """Return the colour that a material gives itself, red, green and blue from 0 to 1."""
    coat = material.find("color")
    try:
        return (
            None
            if coat is None
            else tuple(map(float, coat.get("rgba", "").split()))[:3]
        )
    except ValueError:
        return None


def _saturation(channels: tuple[float, ...]) -> float:
    """Return how far from grey a colour is, 0 to 1; what is nearly black counts as grey."""
    bright = max(channels, default=0.0)
    return (bright - min(channels)) / bright if bright > 0.2 else 0.0


_GREYS = ((178, 170, 158), (196, 201, 207), (140, 146, 154))


def coloured_fixtures(
    cell: Workcell,
) -> Iterator[tuple[Fixture, tuple[int, int, int]]]:
    """Yield the fixtures of a cell with their colours, 0 to 255: their own, or greys."""
    ground, *others = _GREYS
    for k, fixture in enumerate(cell.fixtures):
        # The first one, mostly the table, is told apart from all that stand on it.
        grey = ground if k == 0 else others[(k - 1) % len(others)]
        yield fixture, fixture.colour or grey


def painted_description(
    robot: PlacedRobot, colour: tuple[int, int, int], *, linear: bool = False
) -> ElementTree.ElementTree[ElementTree.Element]:
    """Return a URDF in the robot's colour, every mesh path absolute: package roots differ.

    Args:
        robot: the robot.
        colour: red, green and blue, 0 to 255.
        linear: see paint.
    """
    tree = ElementTree.parse(robot.model.urdf)
    for mesh in tree.getroot().iter("mesh"):
        found = find_mesh(mesh.get("filename", ""), robot.model.package_dirs)
        if found is not None:
            mesh.set("filename", str(found.resolve()))
    _show_hidden(robot, tree.getroot())
    paint(tree.getroot(), colour, linear=linear)
    return tree


def _show_hidden(robot: PlacedRobot, root: ElementTree.Element) -> None:
    """Have an arm or a tool of which a URDF shows nothing shown by what it collides with."""
    groups: dict[str, set[str]] = {}
    for part in robot.model.parts:
        groups.setdefault(part.group, set()).add(part.body.name.rpartition("_")[0])
    links = root.findall("link")
    for names in groups.values():
        own = [link for link in links if link.get("name") in names]
        if any(link.find("visual") is not None for link in own):
            continue
        for link in own:
            for collision in link.findall("collision"):
                shown = copy.deepcopy(collision)
                shown.tag = "visual"
                looks = ElementTree.SubElement(shown, "material", name="shown")
                ElementTree.SubElement(looks, "color", rgba="0.7 0.7 0.7 1")
                link.append(shown)
