"""Convex corners of collision shapes: exact for boxes, around round shapes, hulls of meshes."""

from __future__ import annotations

from typing import Any

import numpy as np

from planning.cell.cover import hull_vertices
from planning.errors import RobotModelError
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


_SIDES = 24


def frustum(
    radius_low: float, radius_high: float, low: float, high: float, sides: int = _SIDES
) -> Array:
    """Return the corners of a prism around a cone frustum (or cylinder) along z.

    Args:
        radius_low, radius_high: radii at the two ends [m].
        low, high: z of the two ends [m].
        sides: number of side faces; each touches the cone.

    Returns:
        Shape (2 * sides, 3), the low ring first.
    """
    angle = 2.0 * np.pi * np.arange(sides) / sides
    ring = np.column_stack([np.cos(angle), np.sin(angle)]) / np.cos(np.pi / sides)
    return np.vstack(
        [
            np.column_stack([radius_low * ring, np.full(sides, low)]),
            np.column_stack([radius_high * ring, np.full(sides, high)]),
        ]
    )


def sphere(radius: float, sides: int = _SIDES) -> Array:
    """Return the corners of a polyhedron around a sphere, shape (v, 3).

    A ring every ``pi / sides`` of latitude; the faces of such a net come no closer to the
    centre than ``cos(pi / sides) ** 2`` of its corners, by which the radius is enlarged.
    """
    latitude = np.linspace(-np.pi / 2, np.pi / 2, sides + 1)
    longitude = 2.0 * np.pi * np.arange(sides) / sides
    lat, lon = (grid.ravel() for grid in np.meshgrid(latitude, longitude))
    unit = np.column_stack(
        [np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)]
    )
    return np.asarray(np.unique(radius / np.cos(np.pi / sides) ** 2 * unit, axis=0))
