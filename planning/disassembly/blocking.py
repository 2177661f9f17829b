"""Which bodies block which others along a direction, and contacts between them.

A body that leaves along a direction, however far, meets another one if and only if that one is somewhere farther along
the direction than it: on a common line. So it is enough to compare the rear faces of the one with the front faces
of the other in the projection along the direction. There are no steps along the path, and nothing passes between them.
The result for a pair of bodies does not depend on which others are there.

Both bodies are reduced first (``body``), such that contacts do not count. Pairs that overlap in the finished
assembly, such as a press fit, a modelled thread, or a pin in a coarsely tessellated bore of its own diameter, are
reduced further, until they do not.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import combinations

import numpy as np

from planning.caches import BoundedCache
from planning.contacts.surface_depth import winding_number
from planning.disassembly.body import AssemblyBody, surface_of
from planning.disassembly.triangle_tree import (
    TriangleView,
    greatest_rise,
    rises_above,
    view_of,
)
from planning.errors import ShapeError
from planning.transforms import Array, frame_along

REDUCTION = 1e-5
"""How much smaller bodies are taken to be, on all sides: the slack of contacts is twice this [m]."""

DEEPEST_PRESS = 1.28e-3
"""Bodies that are deeper in each other are refused [m]."""

CLEAR = 1e-3
"""Bodies are clear of each other at this distance [m]."""

_SKEW = np.array([0.3571, 0.4829, 0.7995])
"""A direction to which hardly any face is parallel."""

_FLAT = 1e-6
"""Faces whose normal is closer to perpendicular to a direction, as a cosine, have no area along it."""

_MOST_SEEN = 6_000_000
"""Triangles in the views of bodies that are kept, about 60 bytes each."""


class Blocking:
    """Bodies of a finished assembly, with different names, and which ones block which others.

    Raises:
        ShapeError: a surface cannot be used, or two bodies overlap too deeply.
    """

    def __init__(self, bodies: Sequence[AssemblyBody]) -> None:
        self.names = tuple(body.name for body in bodies)
        self.surfaces = {body.name: surface_of(body) for body in bodies}
        most = max(len(surface.faces) for surface in self.surfaces.values())
        self._views: BoundedCache[TriangleView] = BoundedCache(
            max(16, _MOST_SEEN // most)
        )
        self._known: dict[tuple[str, str, bytes], bool] = {}
        self._boxes = {
            name: (own.vertices.min(axis=0), own.vertices.max(axis=0))
            for name, own in self.surfaces.items()
        }
        self.pressed: dict[frozenset[str], float] = {}
        """Pairs that overlap in the finished assembly, and what both together are reduced by [m]."""
        for pair in combinations(self.names, 2):
            self._find_press(*pair)

    def near(self, first: str, second: str, within: float) -> bool:
        """Return whether the boxes around two bodies are no farther apart than a distance along any axis [m]."""
        (low, high), (least, most) = self._boxes[first], self._boxes[second]
        return bool(np.all(low <= most + within) and np.all(least <= high + within))

    def blocks(self, other: str, body: str, direction: Array) -> bool:
        """Return whether one body is in the way of another that leaves along a unit vector, straight and however far."""
        # The other one, moved the opposite way, meets the body likewise.
        if direction[np.flatnonzero(np.abs(direction) > 1e-9)[0]] < 0.0:
            return self.blocks(body, other, -direction)
        key = other, body, np.round(direction, 9).tobytes()
        if key not in self._known:
            by = 0.5 * self.pressed.get(frozenset((other, body)), 2.0 * REDUCTION)
            rear = self._view(body, direction, by, front=False)
            front = self._view(other, direction, by, front=True)
            self._known[key] = rises_above(rear, front)
        return self._known[key]

    def clear_length(self, body: str, others: Iterable[str], direction: Array) -> float:
        """Return the length of a free straight motion along a unit vector after which a body stays clear of others [m]."""
        rear = self._view(body, direction, 0.0, front=False)
        fronts = (self._view(o, direction, 0.0, front=True) for o in others)
        rises = (greatest_rise(rear, front, CLEAR) for front in fronts)
        return max(rises, default=0.0) + CLEAR

    def _find_press(self, first: str, second: str) -> None:
        """Note by how much two bodies overlap, if they do."""
        if not self.near(first, second, 0.0):
            return
        by = REDUCTION
        deep = self._contains(first, second) or self._contains(second, first)
        while deep or self._crosses(first, second, by):
            by *= 2.0
            self.pressed[frozenset((first, second))] = 2.0 * by
            if deep or 2.0 * by > DEEPEST_PRESS:
                deepest = f"more than {1e3 * DEEPEST_PRESS:.2f} mm where they belong"
                raise ShapeError(
                    f"{first} and {second} are in each other by {deepest}: correct their"
                    " places or shapes, or export them as one body"
                )

    def _contains(self, outer: str, inner: str) -> bool:
        """Return whether a body is in the material of another one, given that their surfaces do not meet."""
        (low, high), (least, most) = self._boxes[outer], self._boxes[inner]
        if np.any(least < low) or np.any(most > high):
            return False
        around, own = self.surfaces[outer], self.surfaces[inner]
        triangles = around.vertices[around.faces]
        return abs(winding_number(own.reduced(REDUCTION)[0], triangles)) > 0.5

    def _crosses(self, first: str, second: str, by: float) -> bool:
        """Return whether two bodies overlap that are made smaller."""
        # Not by the same distance: surfaces in one plane would not cross each other.
        one = self._view(first, _SKEW, 0.75 * by, front=None)
        other = self._view(second, _SKEW, 1.25 * by, front=None)
        return rises_above(one, other, crosses=True)

    def _view(
        self, name: str, direction: Array, by: float, *, front: bool | None
    ) -> TriangleView:
        """Return a body seen along a direction: its front or rear faces, or both."""
        key = name, direction.tobytes(), by, front

        def view() -> TriangleView:
            surface = self.surfaces[name]
            along = surface.normals @ direction
            if front is None:
                counts = np.ones(len(along), dtype=bool)
            else:
                counts = along > _FLAT if front else along < -_FLAT
            points = surface.reduced(by) @ frame_along(direction).T
            return view_of(surface.tree, points, counts)

        return self._views.get(key, view)
