"""Convex polyhedra that contain round shapes."""

from __future__ import annotations

import numpy as np

from planning.transforms import Array

_SIDES = 24


def frustum(
    radius_low: float, radius_high: float, low: float, high: float, sides: int = _SIDES
) -> Array:
    """Return the corners of a prism around a cone frustum (or cylinder) along z.

    Args:
        radius_low, radius_high: radii at the two ends [m].
        low, high: z of the two ends [m].
        sides: number of side faces; each touches the cone.

    Returns:
        Shape (2 * sides, 3), the low ring first.
    """
    angle = 2.0 * np.pi * np.arange(sides) / sides
    ring = np.column_stack([np.cos(angle), np.sin(angle)]) / np.cos(np.pi / sides)
    return np.vstack(
        [
            np.column_stack([radius_low * ring, np.full(sides, low)]),
            np.column_stack([radius_high * ring, np.full(sides, high)]),
        ]
    )


def sphere(radius: float, sides: int = _SIDES) -> Array:
    """Return the corners of a polyhedron around a sphere, shape (v, 3).

    A ring every ``pi / sides`` of latitude; the faces of such a net come no closer to the
    centre than ``cos(pi / sides) ** 2`` of its corners, by which the radius is enlarged.
    """
    latitude = np.linspace(-np.pi / 2, np.pi / 2, sides + 1)
    longitude = 2.0 * np.pi * np.arange(sides) / sides
    lat, lon = (grid.ravel() for grid in np.meshgrid(latitude, longitude))
    unit = np.column_stack(
        [np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)]
    )
    return np.asarray(np.unique(radius / np.cos(np.pi / sides) ** 2 * unit, axis=0))
