"""Penetration depth of a triangle mesh in a convex solid, and a test whether a point is inside the mesh.

The depth of a point in a convex solid is a concave function. Over a triangle, its tangent planes bound it from above.
Triangles are halved if their bound is greater than the depth found so far.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from planning.transforms import Array

_TOLERANCE = 1e-6
"""Accuracy of depths [m]."""

_MOST_TRIANGLES = 40_000
"""Most triangles that are examined together; with more, the upper bound is returned."""


@dataclass(frozen=True)
class ConvexSolid:
    """A convex solid between planes.

    Attributes:
        normals: of its planes, outwards, shape (p, 3).
        offsets: of its planes from the origin along them, shape (p,) [m].
        inner: depth of its deepest point, approximately [m].
        middle: a point inside of it, shape (3,) [m].
        low, high: corners of the box around it, shape (3,) [m].
    """

    normals: Array
    offsets: Array
    inner: float
    middle: Array
    low: Array
    high: Array

    def depths(self, points: Array) -> Array:
        """Return the depths of points in the solid, negative outside, shape (n,) [m]."""
        return np.asarray((self.offsets - points @ self.normals.T).min(axis=1))

    def bounds(self, triangles: Array, centres: Array) -> Array:
        """Return an upper bound of the depth of each triangle, shape (n,) [m]."""
        out = self.offsets - triangles @ self.normals.T
        return np.asarray(out.max(axis=1).min(axis=1))


@dataclass(frozen=True)
class RoundSolid(ConvexSolid):
    """All points near a piece of the z axis, such as a cylinder or capsule, cut by planes if there are any.

    Attributes:
        radius: of its round side [m].
        reach: half the length of that piece, infinite for the round side of a cylinder [m].
    """

    radius: float
    reach: float

    def depths(self, points: Array) -> Array:
        """Return the depths of points in the solid, negative outside, shape (n,) [m]."""
        around = self.radius - np.linalg.norm(self._from_axis(points), axis=-1)
        if not len(self.offsets):
            return np.asarray(around)
        return np.asarray(np.minimum(around, super().depths(points)))

    def bounds(self, triangles: Array, centres: Array) -> Array:
        """Return an upper bound of the depth of each triangle, shape (n,) [m]."""
        away = self._from_axis(centres)
        length = np.linalg.norm(away, axis=1)
        slope = -away / np.maximum(length, 1e-12)[:, None]
        offsets = np.einsum("nkx,nx->nk", triangles - centres[:, None], slope)
        around = self.radius - length + offsets.max(axis=1)
        if not len(self.offsets):
            return np.asarray(around)
        return np.asarray(np.minimum(around, super().bounds(triangles, centres)))

    def _from_axis(self, points: Array) -> Array:
        """Return vectors to points from the nearest point of the axis, shape (n, 3) [m]."""
        out = points.copy()
        out[..., 2] -= np.clip(points[..., 2], -self.reach, self.reach)
        return out


def deepest_point(solid: ConvexSolid, triangles: Array) -> float:
    """Return the depth of the deepest point of a surface in a solid [m], minus infinity if none is inside.

    Args:
        solid: in its own frame.
        triangles: of the surface in the same frame, shape (n, 3, 3) [m].
    """
    best = -math.inf
    reached = (triangles.max(axis=1) >= solid.low) & (
        triangles.min(axis=1) <= solid.high
    )
    left = triangles[reached.all(axis=1)]
    while len(left):
        centres = left.mean(axis=1)
        bound = solid.bounds(left, centres)
        near = bound > max(best, 0.0)
        left, centres, bound = left[near], centres[near], bound[near]
        if not len(left):
            break
        looked = np.vstack([centres, left.reshape(-1, 3)])
        best = max(best, float(solid.depths(looked).max()))
        left = left[bound > max(best, 0.0) + _TOLERANCE]
        if len(left) > _MOST_TRIANGLES:
            return float(bound.max())
        left = _halved(left)
    return best if best > 0.0 else -math.inf


def _halved(triangles: Array) -> Array:
    """Return the halves of triangles, cut at the midpoints of their longest edges."""
    edges = triangles[:, [1, 2, 0]] - triangles
    longest = np.einsum("nkx,nkx->nk", edges, edges).argmax(axis=1)
    order = (longest[:, None] + np.arange(3)) % 3
    a, b, c = np.moveaxis(
        np.take_along_axis(triangles, order[:, :, None], axis=1), 1, 0
    )
    middle = 0.5 * (a + b)
    return np.concatenate([np.stack([a, middle, c], 1), np.stack([middle, b, c], 1)])


def winding_number(point: Array, triangles: Array) -> float:
    """Return how often a closed surface goes around a point: 1 inside of it, 0 outside.

    Args:
        point: shape (3,) [m].
        triangles: of the surface, anticlockwise as seen from outside, shape (n, 3, 3) [m].
    """
    a, b, c = np.moveaxis(triangles - point, 1, 0)
    la, lb, lc = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    volume = np.einsum("nx,nx->n", a, np.cross(b, c))
    dots = [np.einsum("nx,nx->n", *pair) for pair in ((a, b), (b, c), (c, a))]
    under = la * lb * lc + dots[0] * lc + dots[1] * la + dots[2] * lb
    return float(np.arctan2(volume, under).sum() / (2.0 * math.pi))
