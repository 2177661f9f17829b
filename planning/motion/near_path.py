"""Points of a path in joint space that are nearest to given configurations."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planning.transforms import Array, Indices


class NearPath(NamedTuple):
    """Points of a polyline in joint space nearest to query points, one for each.

    Attributes:
        leg: index of the straight leg that contains each nearest point, from 0, shape (k,).
        share: position on that leg as a fraction, from 0 to 1, shape (k,).
        q: the nearest points, shape (k, n).
        off: largest difference of a joint value from the query point, shape (k,) [rad or m].
    """

    leg: Indices
    share: Array
    q: Array
    off: Array


def nearest_points_on_path(points: Array, q: Array) -> NearPath:
    """Return the points of a polyline nearest to query points.

    Args:
        points: ends and corners of the polyline, at least one, shape (w, n).
        q: the query points, shape (k, n).
    """
    begins = points[: max(len(points) - 1, 1)]
    displacements = points[1:] - begins if len(points) > 1 else np.zeros_like(begins)
    squares = np.maximum((displacements**2).sum(axis=1), 1e-18)
    here = q[:, None]
    share = np.clip(((here - begins) * displacements).sum(axis=2) / squares, 0.0, 1.0)
    near = begins + share[:, :, None] * displacements
    off = np.abs(near - here).max(axis=2)
    leg = off.argmin(axis=1)
    row = np.arange(len(leg))
    return NearPath(leg, share[row, leg], near[row, leg], off[row, leg])
