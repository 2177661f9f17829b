"""Conversion of shapes to convex shapes of coal, and their extents along directions and from points.

Boxes, cylinders and other primitives are kept as primitives. Meshes become their convex pieces.
"""

from __future__ import annotations

from itertools import product
from typing import Any

import coal
import numpy as np

from planning.cell.shape import Box, Capsule, Cylinder, Form, Shape
from planning.kernels import kernel
from planning.transforms import Array, Transform

_AT_ONCE = 512
"""Directions that fit into a processor's nearest memory."""


def coal_forms(shape: Shape) -> list[tuple[Any, Transform]]:
    """Return coal's convex shapes of a shape, each with its pose in the frame of the shape."""
    return [
        (item, element.pose)
        for element in shape.elements
        for item in _forms(element.form)
    ]


def _forms(form: Form) -> list[Any]:
    if isinstance(form, Box | Cylinder | Capsule):
        return [primitive_of(form)]
    return [hull_of(points) for points in form.hulls]


def primitive_of(form: Box | Cylinder | Capsule) -> Any:
    """Return coal's shape of a form that is no mesh."""
    if isinstance(form, Box):
        return coal.Box(*form.size)
    if isinstance(form, Cylinder):
        return coal.Cylinder(form.radius, form.length)
    # Also without length: coal's own answer for a sphere deep in a cylinder is the way out
    # through the side, even where that through an end is shorter.
    return coal.Capsule(form.radius, form.length)


def hull_of(points: Array) -> Any:
    """Return the convex hull of points, shape (p, 3), as coal's shape."""
    model = coal.BVHModelOBBRSS()
    model.beginModel(0, len(points))
    model.addVertices(np.asarray(points, dtype=np.float64))
    model.endModel()
    return convex_of(model)


def convex_of(shape: Any) -> Any:
    """Return a coal primitive unchanged, and the convex hull of a mesh."""
    if hasattr(shape, "buildConvexHull"):
        shape.buildConvexHull(True, "Qt")
        return shape.convex
    return shape


def farthest(shape: Any, directions: Array) -> Array:
    """Return an upper bound of a shape's extent along directions of its own frame, shape (k,).

    Args:
        shape: coal's shape.
        directions: of unit length, shape (k, 3).
    """
    grown = float(shape.getSweptSphereRadius())
    if isinstance(shape, coal.Box):
        return np.asarray(np.abs(directions) @ shape.halfSide + grown)
    if isinstance(shape, coal.Sphere):
        return np.full(len(directions), shape.radius + grown)
    along = directions[:, 2]
    if isinstance(shape, coal.Capsule):
        return np.asarray(np.abs(along) * shape.halfLength + shape.radius + grown)
    if isinstance(shape, coal.Cylinder):
        across = np.sqrt(np.maximum(1.0 - along * along, 0.0))
        return np.asarray(
            np.abs(along) * shape.halfLength + across * shape.radius + grown
        )
    if isinstance(shape, coal.ConvexBase):
        across = np.ascontiguousarray(directions.T)
        return np.asarray(_support(shape.points(), across) + grown)
    # Whatever else: the corners of the box around it.
    shape.computeLocalAABB()
    around = shape.aabb_local
    middle, half = 0.5 * (around.max_ + around.min_), 0.5 * (around.max_ - around.min_)
    return np.asarray(directions @ middle + np.abs(directions) @ half)


@kernel
def _support(points: Array, directions: Array) -> Array:
    """Return the largest extent of points along directions, shape (k,).

    Some directions at a time, all of them point by point: that is what processors do several of at once.

    Args:
        points: shape (p, 3).
        directions: shape (3, k).
    """
    count = directions.shape[1]
    most = np.full(count, -np.inf)
    for begin in range(0, count, _AT_ONCE):
        end = min(begin + _AT_ONCE, count)
        x, y, z = directions[0], directions[1], directions[2]
        for p in range(len(points)):
            a, b, c = points[p, 0], points[p, 1], points[p, 2]
            for k in range(begin, end):
                along = a * x[k] + b * y[k] + c * z[k]
                most[k] = along if along > most[k] else most[k]
    return most


def farthest_from(shape: Any, places: Array) -> Array:
    """Return an upper bound of the distance of a shape's points from positions in its frame, shape (k,).

    Args:
        shape: coal's shape.
        places: shape (k, 3) [m].
    """
    grown = float(shape.getSweptSphereRadius())
    along, across = np.abs(places[:, 2]), np.hypot(places[:, 0], places[:, 1])
    if isinstance(shape, coal.Sphere):
        return np.asarray(np.linalg.norm(places, axis=1) + shape.radius + grown)
    if isinstance(shape, coal.Capsule):
        end = np.hypot(along + shape.halfLength, across)
        return np.asarray(end + shape.radius + grown)
    if isinstance(shape, coal.Cylinder):
        rim = np.hypot(along + shape.halfLength, across + shape.radius)
        return np.asarray(rim + grown)
    if isinstance(shape, coal.ConvexBase):
        corners = shape.points()
    elif isinstance(shape, coal.Box):
        corners = np.array(list(product((-1.0, 1.0), repeat=3))) * shape.halfSide
    else:
        shape.computeLocalAABB()
        around = shape.aabb_local
        corners = np.array(list(product(*zip(around.min_, around.max_, strict=True))))
    squares = (corners**2).sum(axis=1) - 2.0 * places @ corners.T
    away = squares.max(axis=1) + (places**2).sum(axis=1)
    return np.asarray(np.sqrt(np.maximum(away, 0.0)) + grown)
