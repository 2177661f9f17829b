"""Straight lines through a shape: the intervals inside it, and the surface normals at their ends."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.spatial import ConvexHull

from planning.cell.shape import Shape
from planning.transforms import Array, Indices

_PARALLEL = 1e-12
"""Cosine below which a line counts as parallel to a plane."""

_JOINED = 1e-5
"""Gap below which two intervals of a line are merged [m]."""


@dataclass(frozen=True)
class InnerStretch:
    """Interval of a line inside a shape.

    Attributes:
        begin, end: where, along the line [m].
        begin_normal, end_normal: of the surface there, outwards, shape (3,).
    """

    begin: float
    end: float
    begin_normal: Array
    end_normal: Array


@dataclass(frozen=True, eq=False)
class SolidLines:
    """Measures lines through the convex pieces of a shape.

    Attributes:
        shape: the shape.
    """

    shape: Shape

    @cached_property
    def _planes(self) -> tuple[Array, Array, Indices]:
        """Normals and offsets of all face planes, and where those of each piece begin."""
        planes = [ConvexHull(piece.vertices).equations for piece in self.shape.pieces]
        every = np.vstack(planes)
        first = np.cumsum([0, *(len(own) for own in planes[:-1])])
        return every[:, :3], every[:, 3], first

    def spans(self, starts: Array, direction: Array) -> tuple[Array, Array]:
        """Return the intervals of lines inside each piece, shapes (lines, pieces) [m].

        Args:
            starts: a point of each line, from which is measured, shape (lines, 3).
            direction: of all of them, of length one.

        Returns:
            Where they enter and where they leave; what is never inside leaves before it enters.
        """
        _, _, enter, leave = self._cut(starts, direction)
        return enter, leave

    def stretches(self, start: Array, direction: Array) -> list[InnerStretch]:
        """Return the intervals of one line inside the shape, in order."""
        low, high, enters, leaves = self._cut(start[None], direction)
        normals, offsets, first = self._planes
        enter, leave = enters[0], leaves[0]
        ends = np.append(first[1:], len(offsets))
        found: list[InnerStretch] = []
        inside = np.flatnonzero(leave > enter)
        for k in inside[np.argsort(enter[inside], kind="stable")].tolist():
            own = slice(first[k], ends[k])
            end, end_normal = float(leave[k]), normals[own][high[0, own].argmin()]
            if not found or enter[k] > found[-1].end + _JOINED:
                normal = normals[own][low[0, own].argmax()]
                found.append(InnerStretch(float(enter[k]), end, normal, end_normal))
            elif end > found[-1].end:
                found[-1] = replace(found[-1], end=end, end_normal=end_normal)
        return found

    def tops(self, starts: Array, direction: Array) -> Array:
        """Return where lines first hit the shape, infinite where they miss it, shape (lines,)."""
        enter, leave = self.spans(starts, direction)
        return np.asarray(np.where(leave > enter, enter, np.inf).min(axis=1))

    def _cut(
        self, starts: Array, direction: Array
    ) -> tuple[Array, Array, Array, Array]:
        """Return where lines pass each plane, on either side, and where each piece."""
        normals, offsets, first = self._planes
        along = normals @ direction
        height = starts @ normals.T + offsets
        parallel = np.abs(along) < _PARALLEL
        with np.errstate(divide="ignore", invalid="ignore"):
            at = -height / along
        never = parallel & (height > 0.0)
        low = np.where(along < -_PARALLEL, at, -np.inf)
        high = np.where(along > _PARALLEL, at, np.inf)
        low, high = np.where(never, np.inf, low), np.where(never, -np.inf, high)
        enter = np.maximum.reduceat(low, first, axis=1)
        leave = np.minimum.reduceat(high, first, axis=1)
        return low, high, enter, leave
