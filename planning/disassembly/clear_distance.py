"""Length of a straight motion until a body is clear of all others."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import coal
import numpy as np

from planning.caches import BoundedCache
from planning.disassembly.blocking import Blocking
from planning.disassembly.reduced_surface import Surface
from planning.transforms import Array

CLEAR = 1e-3
"""A body is clear of others at this distance [m]."""

_EXACT = 1e-4
"""Lengths are exact to within this [m]."""

_MOST_STEPS = 200
"""Greatest number of steps; a length that is found by then is enough, but not the least."""

_MODELS: BoundedCache[Any] = BoundedCache(256)


def clear_distance(
    blocking: Blocking, name: str, others: Iterable[str], direction: Array
) -> float:
    """Return the least length of a free straight motion after which a body stays clear of others [m].

    From far away, the body comes back in steps that are as long as it is away from each of the others.

    Args:
        blocking: the bodies.
        name: of the body.
        others: names of the others that are there.
        direction: unit vector along which it leaves, shape (3,).
    """
    own = blocking.surfaces[name]
    reach = own.vertices @ direction
    length = 0.0
    for other in others:
        met = blocking.surfaces[other]
        start = float((met.vertices @ direction).max() - reach.min()) + CLEAR
        if start > length:
            length = _length(own, met, direction, start, length)
    return length


def _length(
    own: Surface, met: Surface, direction: Array, start: float, least: float
) -> float:
    length, trees = start, (_model(own), _model(met))
    request = coal.DistanceRequest()
    for _ in range(_MOST_STEPS):
        there = coal.Transform3s(np.eye(3), length * direction)
        result = coal.DistanceResult()
        gap = coal.distance(
            trees[0], there, trees[1], coal.Transform3s(), request, result
        )
        if gap < CLEAR + _EXACT or length <= least:
            break
        length -= gap - CLEAR
    return max(length, least)


def _model(surface: Surface) -> Any:
    """Return the triangles of a surface, as coal has them."""

    def build() -> Any:
        model = coal.BVHModelOBBRSS()
        corners, faces = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
        corners.extend(list(surface.vertices))
        faces.extend([coal.Triangle(*face) for face in surface.faces.tolist()])
        model.beginModel(len(faces), len(corners))
        model.addSubModel(corners, faces)
        model.endModel()
        return model

    return _MODELS.get(surface, build)
