"""How far convex shapes reach along directions: what proves two of them apart without measuring."""

from __future__ import annotations

from itertools import product
from typing import Any

import coal
import numpy as np

from planning.transforms import Array

DIRECTIONS = np.array(
    [d for d in product((-1.0, 0.0, 1.0), repeat=3) if d > (0.0, 0.0, 0.0)]
)
"""Axes, then diagonals, one of each opposite pair, of unit length, shape (13, 3)."""
DIRECTIONS /= np.linalg.norm(DIRECTIONS, axis=1)[:, None]
DIRECTIONS = DIRECTIONS[np.argsort(-np.abs(DIRECTIONS).max(axis=1), kind="stable")]


def farthest(shape: Any, directions: Array) -> Array:
    """Return how far a shape reaches along directions of its own frame, never less, shape (k,).

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
        return np.asarray((directions @ shape.points().T).max(axis=1) + grown)
    # Whatever else: the corners of the box around it.
    shape.computeLocalAABB()
    around = shape.aabb_local
    middle, half = 0.5 * (around.max_ + around.min_), 0.5 * (around.max_ - around.min_)
    return np.asarray(directions @ middle + np.abs(directions) @ half)
