"""Directions along which bodies may leave an assembly: axes of its faces and holes, and others around them."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import combinations

import numpy as np

from planning.disassembly.body import Surface
from planning.transforms import Array, frame_along

_DIGITS = 4
"""Directions that are equal in so many digits are one, which is within 0.03 mm over 300 mm."""

_MOST_FACES = 12
"""Greatest number of face directions of a body, those of the largest area first."""

_MOST_AXES = 6
"""Greatest numbers of axes, those with the most area beside them first, and of face normals."""

_LEAST_SINE = 0.05
"""Normals that are nearly parallel have no certain axis: sine of the angle between them."""

_LEAST_SHARE = 0.01
"""Faces of one direction with a smaller share of the area of a body do not count."""

_MOST_COMMON = 24
"""Greatest number of directions, each with its opposite, that all bodies are tried along."""

_SPREAD = 96
"""Number of directions spread over the sphere."""


def main_directions(up: Array) -> Array:
    """Return up, the directions perpendicular to it that are nearest to coordinate axes, and down, shape (6, 3)."""
    across, side, _ = frame_along(up)
    return np.array([up, across, -across, side, -side, -up])


def face_directions(surface: Surface) -> Array:
    """Return axes along the faces of a body, and the normals of the largest faces, shape (n, 3).

    An axis is perpendicular to two of the normals. That of a bore or a pin is perpendicular to all the normals
    around it, so it has the most area beside it. Of a direction and its opposite, only one is there.
    """
    area = surface.areas
    signs = np.sign(np.round(surface.normals, 6))
    # Of a direction and its opposite, the one whose first coordinate that is not 0 is positive.
    first = signs[np.arange(len(signs)), (signs != 0.0).argmax(axis=1)]
    halves = surface.normals * first[:, None]
    _, number = np.unique(np.round(halves, 4), axis=0, return_inverse=True)
    total = np.bincount(number.ravel(), area)
    largest = np.argsort(-total, kind="stable")[:_MOST_FACES]
    faces = [
        halves[np.where(number.ravel() == k, area, -1.0).argmax()]
        for k in largest
        if total[k] >= _LEAST_SHARE * area.sum()
    ]
    if not faces:
        return np.empty((0, 3))
    axes = (np.cross(a, b) for a, b in combinations(faces, 2))
    long = (
        (axis, size) for axis in axes if (size := np.linalg.norm(axis)) > _LEAST_SINE
    )
    known = different([*faces, *(axis / size for axis, size in long)])
    beside = np.abs(surface.normals @ np.array(known).T) < 1e-3
    order = np.argsort(-(area @ beside), kind="stable")[:_MOST_AXES]
    return np.array(different([*(known[k] for k in order), *faces[:_MOST_AXES]]))


def most_common(directions: Iterable[Array]) -> list[Array]:
    """Return the directions of bodies that most of them have, given those of each, shape (n, 3) each."""
    rows = np.vstack([np.empty((0, 3)), *directions])
    _, first, count = np.unique(
        np.round(rows, _DIGITS) + 0.0, axis=0, return_index=True, return_counts=True
    )
    order = np.lexsort([first, -count])[:_MOST_COMMON]
    return [rows[first[k]] for k in order]


def spread_directions() -> Array:
    """Return directions spread evenly over the sphere, each with its opposite, shape (n, 3)."""
    k = np.arange(_SPREAD // 2)
    height = (k + 0.5) / (_SPREAD // 2)
    turn = k * np.pi * (3.0 - np.sqrt(5.0))
    radius = np.sqrt(1.0 - height**2)
    half = np.column_stack([radius * np.cos(turn), radius * np.sin(turn), height])
    return np.vstack([half, -half])


def different(directions: Iterable[Array]) -> list[Array]:
    """Return the directions that differ from all before them."""
    rows = np.vstack([np.empty((0, 3)), *directions])
    _, first = np.unique(np.round(rows, _DIGITS) + 0.0, axis=0, return_index=True)
    return [rows[k] for k in np.sort(first)]
