"""Contacts of bodies, from the triangles of their surfaces that face each other."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from planning.disassembly.blocking import Blocking
from planning.disassembly.body import Surface
from planning.disassembly.triangle_tree import contact_corners, view_of
from planning.statics.contact_patch import ContactPatch
from planning.transforms import Array, frame_along

_SAME = 0.98
"""Least cosine of normals of faces that count as turned the same way."""

_FACING = -0.94
"""Greatest cosine of normals of faces that face each other: chords of two roundings differ by as much."""

_MOST_NORMALS = 12
"""Greatest number of normals of a body's contacts with another, those of the largest area first."""

_SIDES = 8
"""Directions in which a contact is bounded."""

Patches = dict[tuple[str, str], tuple[ContactPatch, ...]]


def surface_contacts(blocking: Blocking, touch: float) -> Patches:
    """Return the contacts of all pairs of bodies, whose surfaces touch up to a distance [m]."""
    found = {}
    for first, second in combinations(blocking.names, 2):
        if blocking.near(first, second, touch):
            surfaces = blocking.surfaces[first], blocking.surfaces[second]
            press = blocking.pressed.get(frozenset((first, second)), 0.0)
            if patches := _patches(*surfaces, touch + press):
                found[first, second] = patches
    return found


def _patches(first: Surface, second: Surface, touch: float) -> tuple[ContactPatch, ...]:
    out = []
    for normal in _normals_near(first, second, touch):
        frame = frame_along(normal)
        up, down = first.normals @ normal > _SAME, second.normals @ normal < _FACING
        lower = view_of(first.tree, first.vertices @ frame.T, up)
        upper = view_of(second.tree, second.vertices @ frame.T, down)
        corners = contact_corners(lower, upper, touch)
        if len(corners):
            points = corners[_outermost(corners)]
            gap = float(corners[:, 3].min())
            out.append(ContactPatch(points[:, :3] @ frame, normal, gap))
    return tuple(out)


def _normals_near(first: Surface, second: Surface, touch: float) -> list[Array]:
    """Return normals of a body's faces that are near another one, the largest first, none like another."""
    corners = first.vertices[first.faces]
    near = np.all(corners.max(axis=1) >= second.vertices.min(axis=0) - touch, axis=1)
    near &= np.all(corners.min(axis=1) <= second.vertices.max(axis=0) + touch, axis=1)
    area = np.where(near, first.areas, 0.0)
    found: list[Array] = []
    cells, number = np.unique(first.normals.round(4), axis=0, return_inverse=True)
    number = number.ravel()
    while len(found) < _MOST_NORMALS and area.max() > 0.0:
        largest = np.bincount(number, area, len(cells)).argmax()
        normal = first.normals[(number == largest) & (area > 0.0)][0]
        found.append(normal)
        area[first.normals @ normal > _SAME] = 0.0
    return found


def _outermost(points: Array) -> list[int]:
    """Return the numbers of the points that bound others in the plane of the first two coordinates."""
    angles = 2.0 * np.pi * (np.arange(_SIDES) + 0.5) / _SIDES
    sides = np.array([np.cos(angles), np.sin(angles)])
    return sorted(set((points[:, :2] @ sides).argmax(axis=0).tolist()))
