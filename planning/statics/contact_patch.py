"""Contact patch of two convex solids: the contact points and the contact normal.

In input files, solids in contact may have a small gap or a small overlap. The contact normal is the direction of the
largest gap, or of the smallest overlap, among the normals of faces and the common normals of edges (separating
axis theorem). The vertices of each solid within ``SLACK`` of its outermost point along the normal are projected
onto a plane. The contact points are the corners of the intersection of both projections: contact forces
anywhere in this area have an equivalent at its corners.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from planning.cell.body import ConvexBody
from planning.transforms import Array, Transform, read_only_copy

SLACK = 5e-4
"""How far a vertex may be behind the outermost one, along the contact direction, and still touch [m]."""

_THIN = 1e-5
"""Half the width that edges and corners are given [m], so that they have an area to intersect."""

_SAME = 1e-6
"""Directions, or distances [m], that differ by less count as equal."""

_MOST_EDGES = 64
"""Most edge directions of a body that are paired with those of another, longest edges first."""


@dataclass(frozen=True)
class ContactPatch:
    """Contact of two convex solids.

    Attributes:
        points: corners of the area in which they touch, in the world, shape (p, 3) [m].
        normal: unit vector along which the first pushes the second, shape (3,).
        gap: distance along it, negative for overlap [m].
    """

    points: Array
    normal: Array
    gap: float


def contact_patch(
    first: ConvexBody, first_pose: Transform, second: ConvexBody, second_pose: Transform
) -> ContactPatch:
    """Return the contact patch of two nearby solids.

    Args:
        first, second: the solids.
        first_pose, second_pose: their poses in the world.

    Returns:
        The contact, if its ``gap`` is small. The gap of solids that are apart is the greatest along all
        examined directions: equal to their distance where a face or two edges are nearest, less than it
        where corners are.
    """
    a = first.vertices @ first_pose[:3, :3].T + first_pose[:3, 3]
    b = second.vertices @ second_pose[:3, :3].T + second_pose[:3, 3]
    ours, theirs = _bounding_directions(first), _bounding_directions(second)
    axes = _axes(
        (ours.normals @ first_pose[:3, :3].T, ours.edges @ first_pose[:3, :3].T),
        (theirs.normals @ second_pose[:3, :3].T, theirs.edges @ second_pose[:3, :3].T),
    )
    # Of an axis and its opposite, the one along which the second lies beyond the first.
    gaps = (axes @ b.T).min(axis=1) - (axes @ a.T).max(axis=1)
    # Of equally good directions, that of a face comes first: it has the larger area.
    best = int(np.flatnonzero(gaps >= gaps.max() - _SAME)[0])
    normal = axes[best]
    return ContactPatch(_common_points(a, b, normal), normal, float(gaps[best]))


@dataclass(frozen=True)
class Directions:
    """Directions that bound a convex body.

    Attributes:
        normals: outward unit normals of its faces, shape (f, 3).
        edges: unit vectors along its edges, each once, shape (e, 3).
    """

    normals: Array
    edges: Array


def _bounding_directions(body: ConvexBody) -> Directions:
    """Return the normals and edge directions of a body, cached per body."""
    return _directions(body.vertices.tobytes())


@lru_cache(maxsize=4096)
def _directions(corners: bytes) -> Directions:
    points = np.frombuffer(corners).reshape(-1, 3)
    try:
        hull = ConvexHull(points)
    except QhullError:  # flat, or a line: principal axes suffice
        axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=True)[2]
        return Directions(
            read_only_copy(np.vstack([axes, -axes])), read_only_copy(axes)
        )
    normals = hull.equations[:, :3]
    ends: dict[frozenset[int], list[int]] = {}
    for face, simplex in enumerate(hull.simplices):
        for k in range(3):
            ends.setdefault(frozenset({simplex[k], simplex[k - 1]}), []).append(face)
    edges = []
    for pair, faces in ends.items():
        # The common edge of two coplanar triangles is no edge of the body.
        if len(faces) == 2 and normals[faces[0]] @ normals[faces[1]] > 1.0 - _SAME:
            continue
        i, j = pair
        edges.append(points[j] - points[i])
    along = np.array(sorted(edges, key=lambda edge: -float(np.linalg.norm(edge))))
    along /= np.linalg.norm(along, axis=1)[:, None]
    return Directions(
        read_only_copy(_distinct(normals)),
        read_only_copy(_distinct(_with_positive_lead(along))[:_MOST_EDGES]),
    )


def _distinct(vectors: Array) -> Array:
    """Return unit vectors without duplicates, in their order."""
    _, first = np.unique(np.round(vectors / 1e-5), axis=0, return_index=True)
    return np.asarray(vectors[np.sort(first)])


def _with_positive_lead(vectors: Array) -> Array:
    """Return vectors flipped so that the largest of their coordinates is positive."""
    largest = np.abs(vectors).argmax(axis=1)
    sign = np.sign(np.take_along_axis(vectors, largest[:, None], axis=1))
    return np.asarray(vectors * sign)


def _axes(first: tuple[Array, Array], second: tuple[Array, Array]) -> Array:
    """Return the candidate contact directions, from the first body to the second."""
    crossed = np.cross(first[1][:, None], second[1][None, :]).reshape(-1, 3)
    length = np.linalg.norm(crossed, axis=1)
    crossed = crossed[length > 1e-4] / length[length > 1e-4, None]
    return np.vstack([first[0], -second[0], crossed, -crossed])


def _common_points(a: Array, b: Array, normal: Array) -> Array:
    """Return the corners of the contact area of two bodies, half-way between them."""
    first, second = a @ normal, b @ normal
    height = 0.5 * (first.max() + second.min())
    across = np.linalg.svd(normal[None, :])[2][1:]
    ours = _outline(a[first >= first.max() - SLACK] @ across.T)
    theirs = _outline(b[second <= second.min() + SLACK] @ across.T)
    common = _clipped(ours, theirs)
    if not len(common):
        # The nearest features are corners, next to each other.
        common = 0.5 * (ours.mean(axis=0) + theirs.mean(axis=0))[None, :]
    return np.asarray(common @ across + height * normal)


def _outline(points: Array) -> Array:
    """Return the corners of the hull of points in a plane, counter-clockwise, thickened."""
    ring = _THIN * np.array([(1, 0), (0, 1), (-1, 0), (0, -1)], dtype=np.float64)
    thick = (points[:, None, :] + ring[None, :, :]).reshape(-1, 2)
    return np.asarray(thick[ConvexHull(thick).vertices])


def _clipped(polygon: Array, by: Array) -> Array:
    """Return a convex polygon cut by another one (Sutherland and Hodgman), each corner once."""
    for k in range(len(by)):
        start, end = by[k - 1], by[k]
        inward = np.array([start[1] - end[1], end[0] - start[0]])
        height = (polygon - start) @ inward
        kept = []
        for i in range(len(polygon)):
            here, before = height[i], height[i - 1]
            if (here >= 0.0) != (before >= 0.0):
                share = before / (before - here)
                kept.append(polygon[i - 1] + share * (polygon[i] - polygon[i - 1]))
            if here >= 0.0:
                kept.append(polygon[i])
        if not kept:
            return np.empty((0, 2))
        polygon = np.array(kept)
    _, first = np.unique(np.round(polygon / (4 * _THIN)), axis=0, return_index=True)
    return np.asarray(polygon[np.sort(first)])
