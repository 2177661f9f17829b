"""Convex polyhedra that contain round shapes, and the tool cone of our GP4 as a mesh.

``python -m planning.robots.primitives`` writes the committed mesh anew.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from planning.transforms import Array

_SIDES = 24

CONE_MESH = Path(__file__).parent / "urdf" / "meshes" / "tool_cone.obj"


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


def cone_obj() -> str:
    """Return the tool cone (radius 39 mm to 11 mm over 34 mm) as Wavefront OBJ text."""
    sides = _SIDES
    corners = frustum(0.039, 0.011, 0.0, 0.034, sides)
    lines = ["# cone of the GP4's tool: metres, axis z; planning/robots/primitives.py"]
    lines += [f"v {x:.9f} {y:.9f} {z:.9f}" for x, y, z in corners]
    for k in range(sides):
        a, b = k + 1, (k + 1) % sides + 1
        lines += [f"f {a} {b} {b + sides}", f"f {a} {b + sides} {a + sides}"]
    for k in range(2, sides):
        lines += [f"f 1 {k + 1} {k}", f"f {sides + 1} {sides + k} {sides + k + 1}"]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    CONE_MESH.write_text(cone_obj())
