"""Distance between two triangle meshes, and the free travel of one mesh until it touches the other."""

from __future__ import annotations

from typing import Any

import coal
import numpy as np

from planning.caches import BoundedCache
from planning.cell.shape import Element, Mesh
from planning.contacts.surface_depth import winding_number
from planning.transforms import Array, Transform, inverse

_MEETS = 1e-6
"""Distance below which two surfaces count as touching [m]."""

_MOST_STEPS = 300
"""Greatest number of steps of conservative advancement; then the travel found so far is returned."""

_TREES: BoundedCache[Any] = BoundedCache(64)


def surface_gap(one: Element, other: Element) -> float:
    """Return the distance of two meshes, 0 where they meet, one contains the other, or one is no mesh [m]."""
    if not isinstance(one.form, Mesh) or not isinstance(other.form, Mesh):
        return 0.0
    gap = _distance(one, other, one.pose)
    return 0.0 if gap <= _MEETS or _in(one, other) or _in(other, one) else gap


def free_distance(one: Element, other: Element, direction: Array, most: float) -> float:
    """Return a lower bound of a mesh's straight travel until it meets another; infinite beyond ``most`` [m].

    Conservative advancement: a step as long as the surfaces are apart passes no contact.
    """
    distance, pose = 0.0, np.array(one.pose)
    for _ in range(_MOST_STEPS):
        pose[:3, 3] = one.pose[:3, 3] + distance * direction
        gap = _distance(one, other, pose)
        if gap <= _MEETS:
            break
        distance += gap
        if distance >= most:
            return np.inf
    return distance


def _distance(one: Element, other: Element, pose: Transform) -> float:
    """Return the distance of two surfaces with the first one at a pose, not positive where they cross [m]."""
    at, there = (coal.Transform3s(p[:3, :3], p[:3, 3]) for p in (pose, other.pose))
    request, result = coal.DistanceRequest(), coal.DistanceResult()
    trees = _tree(one.form), _tree(other.form)
    return float(coal.distance(trees[0], at, trees[1], there, request, result))


def _tree(form: Any) -> Any:
    """Return the bounding volume hierarchy of the triangles of a mesh."""

    def build() -> Any:
        tree, corners, faces = (
            coal.BVHModelOBBRSS(),
            coal.StdVec_Vec3s(),
            coal.StdVec_Triangle(),
        )
        corners.extend(list(form.vertices))
        faces.extend([coal.Triangle(*face) for face in form.faces.tolist()])
        tree.beginModel(len(faces), len(corners))
        tree.addSubModel(corners, faces)
        tree.endModel()
        return tree

    return _TREES.get(form, build)


def _in(one: Element, other: Element) -> bool:
    """Tell whether a mesh is inside another one whose surface it does not meet."""
    assert isinstance(one.form, Mesh)
    assert isinstance(other.form, Mesh)
    seen = inverse(other.pose) @ one.pose
    corner = seen[:3, :3] @ one.form.vertices[0] + seen[:3, 3]
    return abs(winding_number(corner, other.form.vertices[other.form.faces])) > 0.5
