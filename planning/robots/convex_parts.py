"""Convex corners of collision shapes: exact for boxes, around round shapes, hulls of meshes."""

from __future__ import annotations

from typing import Any

import numpy as np

from planning.cell.cover import hull_vertices
from planning.errors import RobotModelError
from planning.robots.primitives import frustum, sphere
from planning.transforms import Array


def shape_vertices(shape: Any, name: str) -> Array:
    """Return corners whose hull contains a collision shape.

    Args:
        shape: coal geometry as pinocchio loads it: Box, Cylinder, Sphere, Capsule or a mesh.
        name: for messages.

    Returns:
        Shape (v, 3) in the shape's own frame [m].

    Raises:
        RobotModelError: the shape is of another kind, or a mesh without volume.
    """
    kind = type(shape).__name__
    if kind == "Box":
        half = np.asarray(shape.halfSide)
        signs = np.array(np.meshgrid(*[(-1.0, 1.0)] * 3)).reshape(3, -1).T
        return np.asarray(signs * half)
    if kind == "Cylinder":
        length = float(shape.halfLength)
        return frustum(shape.radius, shape.radius, -length, length)
    if kind == "Sphere":
        return sphere(float(shape.radius))
    if kind == "Capsule":
        ends = [[0.0, 0.0, s * float(shape.halfLength)] for s in (-1.0, 1.0)]
        ball = sphere(float(shape.radius))
        return hull_vertices(np.vstack([ball + end for end in ends]))
    if hasattr(shape, "vertices"):
        points = np.asarray(shape.vertices(), dtype=np.float64)
        if len(points) < 4 or not np.all(np.isfinite(points)):
            raise RobotModelError(f"mesh of {name!r} has no volume")
        return hull_vertices(points)
    raise RobotModelError(
        f"collision shape {kind} of {name!r} is not supported",
        choices=("box", "cylinder", "sphere", "mesh"),
    )
