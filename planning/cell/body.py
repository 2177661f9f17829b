"""Convex bodies and the capsules that bound them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from planning.transforms import Array


@dataclass(frozen=True)
class Capsules:
    """Capsules: all points within ``radius`` of the segment ``start``-``end``.

    Attributes:
        start: segment starts, shape (c, 3) [m].
        end: segment ends, shape (c, 3) [m].
        radius: radii, shape (c,) [m].
    """

    start: Array
    end: Array
    radius: Array


@dataclass(frozen=True, eq=False)
class ConvexBody:
    """A convex hull and capsules whose union contains it.

    Contacts are searched with the capsules, which is fast, and decided with the hull.

    Attributes:
        name: unique within what carries the body.
        vertices: corners of the hull, shape (v, 3), in the frame of what carries it [m].
        capsules: a cover of the hull, in the same frame.
    """

    name: str
    vertices: Array
    capsules: Capsules

    @cached_property
    def half(self) -> Array:
        """Half edge lengths of that box, shape (3,) [m]."""
        return np.asarray(0.5 * (self.high - self.low))

    @cached_property
    def middle(self) -> Array | None:
        """Centre of that box, shape (3,), None where it is the origin [m]."""
        middle = np.asarray(0.5 * (self.high + self.low))
        return middle if np.any(middle) else None

    @cached_property
    def low(self) -> Array:
        """Least corner of the box around it, parallel to the axes of the frame, shape (3,) [m]."""
        return np.asarray(self.vertices.min(axis=0))

    @cached_property
    def high(self) -> Array:
        """Greatest corner of that box, shape (3,) [m]."""
        return np.asarray(self.vertices.max(axis=0))
