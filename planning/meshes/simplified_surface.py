"""Simplification of a triangle mesh by edge collapses, and the error that it causes."""

from __future__ import annotations

from dataclasses import dataclass

import coal
import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array

from planning.meshes.holes import undirected_edges
from planning.transforms import Array, Indices

_MIDDLE_WEIGHT = 1e-3
"""Weight of the distance from the middle of an edge, relative to that of the distances from the planes."""

_LEAST_COSINE = 0.2
"""Cosine of the greatest angle by which a collapse may turn a triangle."""

_CHEAP_SHARE = 0.5
"""Share of the edges, those with the least error, that may be collapsed in one round."""

_MOST_ROUNDS = 400
"""Greatest number of rounds of collapses."""


@dataclass(frozen=True, eq=False)
class SimplifiedSurface:
    """A simplified triangle mesh.

    Attributes:
        vertices: shape (v, 3) [m].
        faces: shape (f, 3).
        error: greatest distance of a vertex of the original mesh from this one [m].
    """

    vertices: Array
    faces: Indices
    error: float


def simplify_surface(vertices: Array, faces: Indices, most: int) -> SimplifiedSurface:
    """Return a mesh of at most a number of triangles, or of more where no edge is left to collapse.

    The edges with the least quadric error are collapsed (Garland and Heckbert, SIGGRAPH 1997), in rounds of edges
    that share no triangle. Edges whose collapse would change the topology or flip a triangle are kept, so a
    closed mesh stays closed.

    Args:
        vertices: of the mesh, shape (v, 3) [m].
        faces: triangles of the mesh, shape (f, 3).
        most: greatest number of triangles.
    """
    original, points = vertices, vertices.copy()
    quadrics = _quadrics(points, faces)
    refused = np.empty(0, dtype=np.int64)
    for _ in range(_MOST_ROUNDS):
        if len(faces) <= most:
            break
        edges, count = undirected_edges(faces)
        key = edges[:, 0] * len(points) + edges[:, 1]
        edges = edges[(count == 2) & ~np.isin(key, refused)]
        if len(edges) == 0:
            break
        ends, cost = _collapsed(points, quadrics, edges)
        chosen = _far_apart(edges, cost, len(points))
        chosen = chosen[np.argsort(cost[chosen])][: (len(faces) - most + 1) // 2]
        edges, ends = edges[chosen], ends[chosen]
        good = _keeps_sheets(edges, faces, len(points))
        good &= _keeps_sides(points, faces, edges, ends)
        refused = np.append(refused, edges[~good] @ np.array([len(points), 1]))
        kept, gone = edges[good].T
        points[kept] = ends[good]
        quadrics[kept] += quadrics[gone]
        target = np.arange(len(points))
        target[gone] = kept
        faces = target[faces]
        a, b, c = faces.T
        faces = faces[(a != b) & (b != c) & (c != a)]
    used, number = np.unique(faces, return_inverse=True)
    points, faces = points[used], number.reshape(-1, 3)
    return SimplifiedSurface(points, faces, _error(original, points, faces))


def _quadrics(points: Array, faces: Indices) -> Array:
    """Return the sum of squared distances from the planes at each vertex, shape (v, 4, 4)."""
    a, b, c = (points[faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    area = np.linalg.norm(normal, axis=1)
    normal /= np.maximum(area, 1e-300)[:, None]
    plane = np.column_stack([normal, -np.einsum("fi,fi->f", normal, a)])
    each = np.einsum("f,fi,fj->fij", area, plane, plane)
    out = np.zeros((len(points), 4, 4))
    for k in range(3):
        np.add.at(out, faces[:, k], each)
    return out


def _collapsed(points: Array, quadrics: Array, edges: Indices) -> tuple[Array, Array]:
    """Return the vertices that edges would be collapsed to, shape (e, 3) [m], and their errors, shape (e,)."""
    both = quadrics[edges[:, 0]] + quadrics[edges[:, 1]]
    middle = points[edges].mean(axis=1)
    matrix, offset = both[:, :3, :3], both[:, :3, 3]
    weight = _MIDDLE_WEIGHT * np.trace(matrix, axis1=1, axis2=2) + 1e-12
    off = -offset - np.einsum("eij,ej->ei", matrix, middle)
    moved = np.linalg.solve(matrix + weight[:, None, None] * np.eye(3), off[:, :, None])
    ends = middle + moved[:, :, 0]
    whole = np.column_stack([ends, np.ones(len(ends))])
    cost = np.einsum("ei,eij,ej->e", whole, both, whole)
    length = points[edges[:, 0]] - points[edges[:, 1]]
    # In flat regions, short edges are collapsed first.
    return ends, cost + 1e-6 * weight * np.einsum("ei,ei->e", length, length)


def _far_apart(edges: Indices, cost: Array, count: int) -> Indices:
    """Return the indices of edges with a smaller error than all edges that touch their triangles."""
    order = np.argsort(cost, kind="stable")
    rank = np.empty(len(edges), dtype=np.int64)
    rank[order] = np.arange(len(edges))
    near = rank
    for _ in range(2):
        least = np.full(count, len(edges))
        for k in range(2):
            np.minimum.at(least, edges[:, k], near)
        near = least[edges].min(axis=1)
    cheap = rank < max(1.0, _CHEAP_SHARE * len(edges))
    return np.flatnonzero((rank == near) & cheap)


def _keeps_sheets(edges: Indices, faces: Indices, count: int) -> npt.NDArray[np.bool_]:
    """Tell which edges can be collapsed without a change of topology: their ends have two common neighbours."""
    every = undirected_edges(faces)[0]
    ones = np.ones(2 * len(every))
    rows = np.concatenate([every, every[:, ::-1]])
    beside = csr_array((ones, (rows[:, 0], rows[:, 1])), shape=(count, count))
    common = beside[edges[:, 0]].multiply(beside[edges[:, 1]])
    return np.asarray(common.sum(axis=1) == 2.0)


def _keeps_sides(
    points: Array, faces: Indices, edges: Indices, ends: Array
) -> npt.NDArray[np.bool_]:
    """Tell which edges can be collapsed without flipping a triangle."""
    collapse = np.full(len(points), -1)
    collapse[edges] = np.arange(len(edges))[:, None]
    at = collapse[faces]
    # Triangles with both ends of an edge vanish; no other triangle has corners of two edges.
    touched = np.flatnonzero(np.count_nonzero(at >= 0, axis=1) == 1)
    at = at[touched]
    before = points[faces[touched]]
    after = np.where((at >= 0)[:, :, None], ends[at], before)
    normals = [np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]) for t in (before, after)]
    lengths = np.prod([np.linalg.norm(n, axis=1) for n in normals], axis=0)
    turned = np.einsum("fi,fi->f", *normals) <= _LEAST_COSINE * lengths
    out = np.ones(len(edges), dtype=np.bool_)
    out[at.max(axis=1)[turned]] = False
    return out


def _error(original: Array, points: Array, faces: Indices) -> float:
    """Return the greatest distance of vertices from a mesh [m]."""
    surface = coal.BVHModelOBBRSS()
    surface.beginModel(len(faces), len(points))
    surface.addVertices(points)
    surface.addTriangles(faces.astype(np.uint32))
    surface.endModel()
    ball, at_rest, request = (
        coal.Sphere(0.0),
        coal.Transform3s(),
        coal.DistanceRequest(),
    )
    largest = 0.0
    for point in original:
        pose = coal.Transform3s(np.eye(3), point)
        result = coal.DistanceResult()
        gap = coal.distance(ball, pose, surface, at_rest, request, result)
        largest = max(largest, abs(float(gap)))
    return largest
