"""Round bores of meshes: what the polygon of a hole's wall stands for."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from planning.cell.shape import Cylinder, Element, Mesh
from planning.transforms import Array, Transform, inverse

SNUG = 0.003
"""A wall no further from a peg than this is looked at [m]."""

_END = 1e-4
"""Faces beside a peg reach farther along it than to its very ends, by this [m]."""

_WALL = 0.05
"""Faces of a bore are turned from its axis by no less than nearly a right angle: cosine."""

_ROUND = 2e-5, 5e-3
"""Corners of a bore are on one circle to within this [m], or this share of its radius."""

_WIDEST_GAP = math.radians(30.1)
"""No corner of a bore is further from the next one, around its axis: twelve sides at least [rad]."""


@dataclass(frozen=True)
class Bore:
    """A round hole of a mesh, seen along the axis of a peg.

    Attributes:
        radius: of the circle that its corners are on [m].
        centre: of its axis in the frame of the peg, across it, shape (2,) [m].
        chord: how far its polygon reaches inside of the circle [m].
    """

    radius: float
    centre: Array
    chord: float

    @property
    def off(self) -> float:
        """How far its axis is from that of the peg [m]."""
        return float(np.linalg.norm(self.centre))


def bore_around(form: Cylinder, pose: Transform, mesh: Element) -> Bore | None:
    """Return the bore of a mesh around a round peg, None where there is none.

    Its wall is made of the faces that are turned to the axis of the peg, beside the peg; their corners
    are on one circle and go all around. A hexagon is none.
    """
    wall = mesh.form
    assert isinstance(wall, Mesh)
    seen = inverse(pose) @ mesh.pose
    corners = (wall.vertices @ seen[:3, :3].T + seen[:3, 3])[wall.faces]
    near = np.linalg.norm(corners[:, :, :2], axis=2).max(axis=1) < form.radius + SNUG
    heights, half = corners[:, :, 2], 0.5 * form.length
    near &= (heights.min(axis=1) < half - _END) & (heights.max(axis=1) > _END - half)
    corners = corners[near]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.maximum(np.linalg.norm(normal, axis=1), 1e-300)
    middle = corners.mean(axis=1)
    turned = np.einsum("ij,ij->i", normal[:, :2], middle[:, :2])
    inward = turned < 0.0 if _is_right_side_out(wall) else turned > 0.0
    own = corners[inward & (np.abs(normal[:, 2]) < _WALL * length)]
    if len(own) == 0:
        return None
    points = own[:, :, :2].reshape(-1, 2)
    # The circle through all corners, least squares: |p|^2 = 2 c p + (r^2 - |c|^2).
    rows = np.column_stack([2.0 * points, np.ones(len(points))])
    (x, y, rest), *_ = np.linalg.lstsq(rows, (points**2).sum(axis=1), rcond=None)
    centre, radius = np.array([x, y]), math.sqrt(max(rest + x * x + y * y, 0.0))
    away = np.linalg.norm(points - centre, axis=1)
    if np.abs(away - radius).max() > max(_ROUND[0], _ROUND[1] * radius):
        return None
    turns = np.sort(np.arctan2(*(points - centre).T))
    gap = float(np.diff(turns, append=turns[0] + 2.0 * math.pi).max())
    if gap > _WIDEST_GAP:
        return None
    chord = radius * (1.0 - math.cos(0.5 * gap))
    return Bore(radius, centre, chord)


def _is_right_side_out(mesh: Mesh) -> bool:
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    return float(np.einsum("nx,nx->", a, np.cross(b, c))) >= 0.0
