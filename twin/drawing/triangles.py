"""Triangle meshes of shapes for drawing: round shapes are tessellated finely, meshes are used unchanged."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial import ConvexHull

from planning.cell.cover import box_body
from planning.cell.shape import Box, Capsule, Cylinder, Form, Mesh, Shape
from planning.transforms import Array, Indices

_SIDES = 48
"""Number of sides of the polygons that approximate circles."""

_BENDS = 12
"""Rings of a half-sphere."""


@dataclass(frozen=True, eq=False)
class Triangles:
    """Triangles of a drawn shape.

    Attributes:
        vertices: shape (v, 3) [m].
        normals: that light falls on, shape (v, 3).
        faces: shape (f, 3).
    """

    vertices: Array
    normals: Array
    faces: Indices


def triangles_of(shape: Shape) -> Triangles:
    """Return the triangles of a shape, in its frame."""
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
    """Return triangles without shared corners, so that edges are visible."""
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
    """Return strips of a solid of revolution about z: rings of radius and height, with normals."""
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
        for out, high, side, along in strip:
            vertices.append(np.column_stack([out * cos, out * sin, high * one]))
            normals.append(np.column_stack([side * cos, side * sin, along * one]))
        for low, top in pairwise(range(count, count + len(strip))):
            a, b = low * _SIDES, top * _SIDES
            faces.append(np.column_stack([a + here, a + there, b + there]))
            faces.append(np.column_stack([a + here, b + there, b + here]))
        count += len(strip)
    return Triangles(np.vstack(vertices), np.vstack(normals), np.vstack(faces))
