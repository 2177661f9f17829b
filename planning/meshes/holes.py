"""Holes of a surface: how much of a closed one is missing."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from planning.transforms import Array, Indices


def open_share(vertices: Array, faces: Indices) -> float:
    """Return the share of a surface that is missing where it is not closed.

    Triangles around the middle of its rim close each hole: cracks without an area count nothing.

    Args:
        vertices: each point once, shape (v, 3) [m].
        faces: the three vertices of each triangle, shape (f, 3).

    Returns:
        From 0 for a closed surface to 1.
    """
    directed = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    _, inverse, count = np.unique(
        np.sort(directed, axis=1), axis=0, return_inverse=True, return_counts=True
    )
    rim = directed[count[inverse.reshape(-1)] % 2 == 1]
    if len(rim) == 0:
        return 0.0
    links = coo_array(
        (np.ones(len(rim)), (rim[:, 0], rim[:, 1])), shape=(len(vertices),) * 2
    )
    label = connected_components(links, directed=False)[1][rim[:, 0]]
    missing = 0.0
    for number in np.unique(label):
        own = rim[label == number]
        middle = vertices[np.unique(own)].mean(axis=0)
        missing += _area(vertices[own[:, 0]], vertices[own[:, 1]], middle)
    there = _area(vertices[faces[:, 0]], vertices[faces[:, 1]], vertices[faces[:, 2]])
    return missing / (missing + there)


def _area(a: Array, b: Array, c: Array) -> float:
    """Return the area of triangles [m^2]."""
    return float(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())
