"""Meshes that are the same shape in another pose, within a tolerance; mirror images are not."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from planning.transforms import Array, Indices, Transform

ALIKE = 1e-5
"""Corners of bodies of the same shape are at the same places to within this [m]."""

_SAMPLES = 24
"""Corners at which a candidate pose is tried before all others are."""

_MOST_CANDIDATES = 2000
"""Poses that are tried."""

_WIDE = 0.05
"""The two corners that tell a pose are seen from the centre at this angle at least: its sine."""


@dataclass(frozen=True, eq=False)
class Corners:
    """Corners of a body's triangles, for comparison with others.

    Attributes:
        points: shape (v, 3) [m].
        faces: shape (f, 3).
        volume: [m^3].
    """

    points: Array
    faces: Indices
    volume: float

    @cached_property
    def centre(self) -> Array:
        """Centroid of the surface, which turns with it, shape (3,) [m]."""
        a, b, c = (self.points[self.faces[:, k]] for k in range(3))
        area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
        return np.asarray(area @ (a + b + c) / (3.0 * area.sum()))

    @cached_property
    def away(self) -> Array:
        """Distance of each corner from the centroid, shape (v,) [m]."""
        return np.asarray(np.linalg.norm(self.points - self.centre, axis=1))

    @cached_property
    def tree(self) -> cKDTree:
        """The corners, for queries."""
        return cKDTree(self.points)

    def pose_of(self, other: Corners, within: float = ALIKE) -> Transform | None:
        """Return the pose at which these corners are those of another body.

        Args:
            other: the other body.
            within: greatest distance of a corner from the other's [m].

        Returns:
            Pose in the frame of the other body; None if they are not the same shape.
        """
        if len(self.points) != len(other.points) or len(self.faces) != len(other.faces):
            return None
        size = float(self.away.max())
        if abs(self.volume - other.volume) > 20.0 * size**2 * within:
            return None
        if np.abs(np.sort(self.away) - np.sort(other.away)).max() > 2.0 * within:
            return None
        if np.abs(self.points - other.points).max() <= within:
            return np.eye(4)
        for pose in self._candidates(other, within):
            if self._covers(other, pose, within):
                return pose
        return None

    def _candidates(self, other: Corners, within: float) -> Iterator[Transform]:
        """Yield poses at which two corners are where two of the other body are."""
        chosen = self._telling_pair(within)
        if chosen is None:
            return
        first, second = chosen
        own = self.points - self.centre
        seen = other.points - other.centre
        apart = float(np.linalg.norm(own[first] - own[second]))
        firsts = np.flatnonzero(np.abs(other.away - self.away[first]) <= 2.0 * within)
        seconds = np.flatnonzero(np.abs(other.away - self.away[second]) <= 2.0 * within)
        basis = _basis(own[first], own[second])
        tried = 0
        for a in firsts.tolist():
            gaps = np.linalg.norm(seen[seconds] - seen[a], axis=1)
            for b in seconds[np.abs(gaps - apart) <= 4.0 * within].tolist():
                tried += 1
                if tried > _MOST_CANDIDATES:
                    return
                pose = np.eye(4)
                pose[:3, :3] = _basis(seen[a], seen[b]) @ basis.T
                pose[:3, 3] = other.centre - pose[:3, :3] @ self.centre
                yield pose

    def _telling_pair(self, within: float) -> tuple[int, int] | None:
        """Return two corners at distances from the centroid that few others have."""
        order = np.sort(self.away)
        low = np.searchsorted(order, self.away - 2.0 * within)
        count = np.searchsorted(order, self.away + 2.0 * within, side="right") - low
        # Of those that are as rare, the farthest tell the pose best.
        ranked = np.lexsort((-self.away, count))
        ranked = ranked[self.away[ranked] > 0.2 * order[-1]]
        if not len(ranked):
            return None
        own = self.points - self.centre
        first = int(ranked[0])
        across = np.linalg.norm(np.cross(own[ranked], own[first]), axis=1)
        wide = across > _WIDE * self.away[ranked] * self.away[first]
        return (first, int(ranked[wide.argmax()])) if wide.any() else None

    def _covers(self, other: Corners, pose: Transform, within: float) -> bool:
        step = max(1, len(self.points) // _SAMPLES)
        for chosen in (self.points[::step], self.points):
            moved = chosen @ pose[:3, :3].T + pose[:3, 3]
            if np.max(other.tree.query(moved)[0]) > within:
                return False
        back = (other.points - pose[:3, 3]) @ pose[:3, :3]
        return bool(np.max(self.tree.query(back)[0]) <= within)


def _basis(first: Array, second: Array) -> Array:
    """Return the axes of a frame that two directions define, as columns."""
    x = first / np.linalg.norm(first)
    z = np.cross(first, second)
    z = z / np.linalg.norm(z)
    return np.column_stack([x, np.cross(z, x), z])
