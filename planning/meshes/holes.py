"""Closing of holes in a triangle mesh."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from planning.transforms import Array, Indices


def closed_surface(vertices: Array, faces: Indices) -> tuple[Array, Indices]:
    """Return a surface with its holes closed by triangles around their centres."""
    directed = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    _, inverse, count = np.unique(
        np.sort(directed, axis=1), axis=0, return_inverse=True, return_counts=True
    )
    rim = directed[count[inverse.reshape(-1)] == 1]
    if len(rim) == 0:
        return vertices, faces
    links = coo_array(
        (np.ones(len(rim)), (rim[:, 0], rim[:, 1])), shape=(len(vertices),) * 2
    )
    label = connected_components(links, directed=False)[1][rim[:, 0]]
    points, more = [vertices], [faces]
    for hole, number in enumerate(np.unique(label)):
        own = rim[label == number]
        middle = np.full(len(own), len(vertices) + hole)
        points.append(vertices[np.unique(own)].mean(axis=0)[None])
        more.append(np.column_stack([own[:, 1], own[:, 0], middle]))
    return np.vstack(points), np.vstack(more)
