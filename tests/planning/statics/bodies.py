"""Bodies for tests of balance: boxes and round bars in their places."""

import numpy as np

from planning.cell.body import ConvexBody
from planning.cell.cover import box_body, capsule_cover
from planning.statics.standing import PlacedBody
from planning.transforms import Transform, identity, read_only_copy, translation

Three = tuple[float, float, float]


def box(
    name: str,
    size: Three,
    at: Three,
    turned: Transform | None = None,
    mass: float | None = None,
) -> PlacedBody:
    """Return a box with its centre at a point, as heavy as water by default."""
    pose = translation(*at) @ (identity() if turned is None else turned)
    weight = 1000.0 * float(np.prod(size)) if mass is None else mass
    return PlacedBody(name, (box_body(name, size),), pose, weight, np.zeros(3))


def bar(name: str, radius: float, length: float, pose: Transform) -> PlacedBody:
    """Return a round bar along its z axis, drawn with 24 sides about the circle."""
    angles = 2 * np.pi * (np.arange(24) + 0.5) / 24
    ring = (
        radius / np.cos(np.pi / 24) * np.column_stack([np.cos(angles), np.sin(angles)])
    )
    ends = [np.column_stack([ring, np.full(24, z)]) for z in (-length / 2, length / 2)]
    corners = read_only_copy(np.vstack(ends))
    body = ConvexBody(name, corners, capsule_cover(corners))
    mass = 1000.0 * np.pi * radius**2 * length
    return PlacedBody(name, (body,), pose, mass, np.zeros(3))


def table() -> dict[str, PlacedBody]:
    """Return a table with its top at height 0."""
    return {"table": box("table", (4.0, 4.0, 0.1), (0.0, 0.0, -0.05))}
