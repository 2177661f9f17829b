"""Meshes that are the same shape in another pose, within a tolerance; mirror images are not."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice

import numpy as np

from planning.cad.glb_bodies import CadBody
from planning.transforms import Array, Transform

ALIKE = 1e-5
"""Corners of bodies of the same shape are at the same places to within this [m]."""

_SAMPLES = 24
"""Corners at which a candidate pose is tried before all others are."""

_MOST_CANDIDATES = 2000
"""Poses that are tried."""

_WIDE = 0.05
"""The two corners that tell a pose are seen from the centre at this angle at least: its sine."""


def pose_of(own: CadBody, other: CadBody, within: float = ALIKE) -> Transform | None:
    """Return the pose in the frame of another body at which the corners of a body are those of that, within a distance [m].

    None if they are not the same shape.
    """
    points, others = own.vertices, other.vertices
    if len(points) != len(others) or len(own.faces) != len(other.faces):
        return None
    size = float(own.away.max())
    if abs(own.volume - other.volume) > 20.0 * size**2 * within:
        return None
    if np.abs(np.sort(own.away) - np.sort(other.away)).max() > 2.0 * within:
        return None
    if np.abs(points - others).max() <= within:
        return np.eye(4)
    candidates = islice(_candidates(own, other, within), _MOST_CANDIDATES)
    return next((p for p in candidates if _covers(own, other, p, within)), None)


def _candidates(own: CadBody, other: CadBody, within: float) -> Iterator[Transform]:
    """Yield poses at which two corners are where two of the other body are."""
    chosen = _telling_pair(own, within)
    if chosen is None:
        return
    points, seen = own.vertices - own.centre, other.vertices - other.centre
    first, second = points[chosen]
    firsts, seconds = (
        np.flatnonzero(np.abs(other.away - own.away[k]) <= 2.0 * within) for k in chosen
    )
    apart, basis = np.linalg.norm(first - second), _basis(first, second)
    for a in firsts.tolist():
        gaps = np.linalg.norm(seen[seconds] - seen[a], axis=1)
        for b in seconds[np.abs(gaps - apart) <= 4.0 * within].tolist():
            pose = np.eye(4)
            pose[:3, :3] = _basis(seen[a], seen[b]) @ basis.T
            pose[:3, 3] = other.centre - pose[:3, :3] @ own.centre
            yield pose


def _telling_pair(own: CadBody, within: float) -> list[int] | None:
    """Return two corners at distances from the centroid that few others have."""
    away = own.away
    order = np.sort(away)
    low = np.searchsorted(order, away - 2.0 * within)
    count = np.searchsorted(order, away + 2.0 * within, side="right") - low
    # Of those that are as rare, the farthest tell the pose best.
    ranked = np.lexsort((-away, count))
    ranked = ranked[away[ranked] > 0.2 * order[-1]]
    if not len(ranked):
        return None
    points, first = own.vertices - own.centre, ranked[0]
    across = np.linalg.norm(np.cross(points[ranked], points[first]), axis=1)
    wide = across > _WIDE * away[ranked] * away[first]
    return [int(first), int(ranked[wide.argmax()])] if wide.any() else None


def _covers(own: CadBody, other: CadBody, pose: Transform, within: float) -> bool:
    step = max(1, len(own.vertices) // _SAMPLES)
    for chosen in (own.vertices[::step], own.vertices):
        moved = chosen @ pose[:3, :3].T + pose[:3, 3]
        if np.max(other.tree.query(moved)[0]) > within:
            return False
    back = (other.vertices - pose[:3, 3]) @ pose[:3, :3]
    return bool(np.max(own.tree.query(back)[0]) <= within)


def _basis(first: Array, second: Array) -> Array:
    """Return the axes of a frame that two directions define, as columns."""
    x = first / np.linalg.norm(first)
    z = np.cross(first, second)
    z = z / np.linalg.norm(z)
    return np.column_stack([x, np.cross(z, x), z])
