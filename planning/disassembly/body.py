"""Rigid bodies of a finished assembly: closed meshes, and surfaces that are reduced a little.

So what touches, or fits tightly, is apart. Every vertex is moved into its body, such that each plane at it moves by
the same distance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from planning.disassembly.triangle_tree import TriangleTree, build_tree
from planning.errors import ShapeError
from planning.transforms import Array, Indices

if TYPE_CHECKING:
    import trimesh

_MOST_TRIANGLES = 400_000
"""Greatest number of triangles of a body."""

_LONGEST = 4.0
"""Greatest displacement of a vertex, as a multiple of that of its planes."""

_DEPENDENT = 0.01
"""Normals at a vertex are dependent if an eigenvalue of the sum of their squares is a smaller share of the greatest."""


@dataclass(frozen=True, eq=False)
class AssemblyBody:
    """A rigid body of a unique name, with its closed surface in the frame of the finished assembly [m]."""

    name: str
    mesh: trimesh.Trimesh
    density_kg_m3: float = 1000.0


@dataclass(frozen=True, eq=False)
class Surface:
    """Closed surface of a body.

    Attributes:
        vertices: shape (v, 3) [m].
        faces: triangles, corners counter-clockwise seen from outside, shape (f, 3).
        normals: outward unit normals of the triangles, shape (f, 3).
        areas: of the triangles, shape (f,) [m^2].
        inward: displacement of the vertices that moves the planes at them by 1 into the body, shape (v, 3).
        pairs: triangles that share an edge, shape (e, 2).
        bends: angles between their normals, shape (e,) [rad].
        tree: boxes around the triangles.
    """

    vertices: Array
    faces: Indices
    normals: Array
    areas: Array
    inward: Array
    pairs: Indices
    bends: Array
    tree: TriangleTree

    def reduced(self, by: float) -> Array:
        """Return the vertices of the surface that lies deeper by a distance, shape (v, 3) [m]."""
        return np.asarray(self.vertices + by * self.inward)


def surface_of(body: AssemblyBody) -> Surface:
    """Return the surface of a body.

    Raises:
        ShapeError: its mesh is not closed, has no volume, or has too many triangles.
    """
    mesh = body.mesh.copy()
    if len(mesh.faces) > _MOST_TRIANGLES:
        words = f"has {len(mesh.faces)} triangles, more than {_MOST_TRIANGLES}"
        raise ShapeError(f"{body.name} {words}: export it with a coarser tessellation")
    if not np.isfinite(mesh.vertices).all():
        raise ShapeError(f"{body.name} has coordinates that are not finite")
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    mesh.update_faces(mesh.nondegenerate_faces(height=1e-12))
    if not mesh.is_watertight or not mesh.is_winding_consistent:
        raise ShapeError(f"the surface of {body.name} is not closed")
    if mesh.volume < 0.0:
        mesh.invert()
    if mesh.volume < 1e-15:
        raise ShapeError(f"{body.name} has no volume")
    vertices, faces = np.array(mesh.vertices), np.array(mesh.faces, np.int64)
    normals = np.array(mesh.face_normals)
    return Surface(
        vertices,
        faces,
        normals,
        np.asarray(mesh.area_faces),
        _inward(vertices, faces, normals, np.asarray(mesh.face_angles)),
        np.asarray(mesh.face_adjacency),
        np.asarray(mesh.face_adjacency_angles),
        build_tree(vertices, faces),
    )


def _inward(vertices: Array, faces: Indices, normals: Array, angles: Array) -> Array:
    """Return the least displacement of each vertex that moves the planes at it by 1, least squares."""
    squares = np.zeros((len(vertices), 3, 3))
    sums = np.zeros((len(vertices), 3))
    for corner in range(3):
        weight = angles[:, corner, None]
        np.add.at(sums, faces[:, corner], weight * normals)
        outer = normals[:, :, None] * normals[:, None, :]
        np.add.at(squares, faces[:, corner], weight[:, :, None] * outer)
    values, axes = np.linalg.eigh(squares)
    certain = values > _DEPENDENT * np.maximum(values[:, -1:], 1e-12)
    shares = np.einsum("vxk,vx->vk", axes, sums) * certain
    shares /= np.where(certain, values, 1.0)
    out = -np.einsum("vxk,vk->vx", axes, shares)
    length = np.linalg.norm(out, axis=1, keepdims=True)
    return np.asarray(out * np.minimum(1.0, _LONGEST / np.maximum(length, 1e-12)))
