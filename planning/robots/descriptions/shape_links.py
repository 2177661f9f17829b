"""Shapes as links of a URDF: boxes and round forms as they are, meshes as their convex pieces."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from hashlib import sha256
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement

import numpy as np
from scipy.spatial import ConvexHull

from planning.cell.forms import Box, Capsule, Cylinder, Form, Mesh
from planning.cell.shape import Element as Placed
from planning.robots.descriptions.held_joints import pose_of, write_pose
from planning.robots.descriptions.kept_descriptions import kept_folder
from planning.transforms import Array, Indices, Transform, translation

_COLOUR = "0.35 0.37 0.40 1"

Piece = tuple[str, dict[str, str], Transform]
"""Tag and attributes of a shape of URDF, and its pose in the frame of the form."""


def urdf_of_shapes(name: str, shapes: Sequence[Placed]) -> Element:
    """Return the description of a thing of one link.

    Args:
        name: of the thing and of its link.
        shapes: what it is made of, each in its place in the frame of the link.
    """
    root = Element("robot", name=name)
    link = SubElement(root, "link", name=name)
    for shape in shapes:
        for tag, keys, pose in _collisions(shape.form):
            _write(link, "collision", (tag, keys, shape.pose @ pose))
        for tag, keys, pose in _visuals(shape.form):
            _write(link, "visual", (tag, keys, shape.pose @ pose))
    return root


def cut_meshes(root: Element, within: float) -> None:
    """Put convex pieces in the place of the meshes that the links of a description collide with.

    Args:
        root: of a URDF whose meshes have absolute names, changed.
        within: how deep a hollow may be that a piece fills [m].

    Raises:
        ShapeError: a mesh cannot be cut.
    """
    from planning.meshes.mesh_form import mesh_form

    for link in root.findall("link"):
        for collision in link.findall("collision"):
            mesh = collision.find("geometry/mesh")
            if mesh is None:
                continue
            scale = [float(factor) for factor in mesh.get("scale", "1 1 1").split()]
            if len(set(scale)) > 1:
                continue  # a hull is what is left for what is stretched
            form = mesh_form(Path(mesh.get("filename", "")), scale[0], within)
            where = f"link {link.get('name')!r}"
            pose = pose_of(collision.find("origin"), where)
            link.remove(collision)
            for tag, keys, own in _collisions(form):
                _write(link, "collision", (tag, keys, pose @ own))


def _collisions(form: Form) -> Iterator[Piece]:
    here = np.eye(4)
    if isinstance(form, Mesh):
        for hull in form.hulls:
            faces = ConvexHull(hull).simplices.astype(np.int64)
            yield "mesh", {"filename": _obj(hull, faces)}, here
        return
    if isinstance(form, Box):
        yield "box", {"size": " ".join(repr(float(edge)) for edge in form.size)}, here
        return
    radius = repr(float(form.radius))
    if isinstance(form, Cylinder) or form.length > 0.0:
        keys = {"radius": radius, "length": repr(float(form.length))}
        yield "cylinder", keys, here
    if isinstance(form, Capsule):
        for end in (-0.5, 0.5) if form.length > 0.0 else (0.0,):
            at = translation(0.0, 0.0, end * form.length)
            yield "sphere", {"radius": radius}, at


def _visuals(form: Form) -> Iterator[Piece]:
    if isinstance(form, Mesh):
        yield "mesh", {"filename": _obj(form.vertices, form.faces)}, np.eye(4)
    else:
        yield from _collisions(form)


def _write(link: Element, tag: str, piece: Piece) -> None:
    kind, keys, pose = piece
    element = SubElement(link, tag)
    write_pose(element, pose)
    SubElement(SubElement(element, "geometry"), kind, keys)
    if tag == "visual":
        SubElement(SubElement(element, "material", name=""), "color", rgba=_COLOUR)


def _obj(vertices: Array, faces: Indices | Array) -> str:
    """Write triangles to a file that is kept; return its path."""
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in np.asarray(vertices).tolist()]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in np.asarray(faces).tolist()]
    text = "\n".join(lines) + "\n"
    path = kept_folder() / f"{sha256(text.encode()).hexdigest()[:16]}.obj"
    if not path.exists():
        draft = path.with_suffix(".new")
        draft.write_text(text)
        draft.replace(path)
    return str(path)
