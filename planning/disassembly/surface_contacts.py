"""Contacts of bodies, from the triangles of their surfaces that face each other."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np

from planning.disassembly.blocking import Blocking
from planning.disassembly.reduced_surface import Surface
from planning.disassembly.triangle_tree import DEEPEST, overlap_heights, view_of
from planning.kernels import kernel
from planning.statics.contact_patch import ContactPatch
from planning.transforms import Array, Indices

_FACING = -0.94
"""Greatest cosine of normals of triangles that face each other: chords of two roundings differ by as much."""

_ONE_PLANE = 0.05
"""Contacts of a pair whose normals differ by less have one normal."""

_MOST_NORMALS = 8
"""Greatest number of normals of the contacts of a pair, those farthest from each other."""

_SIDES = 8, 4
"""Directions in which the one contact of a pair, or each of several, is bounded."""

_ROOM = 4096
"""Corners of contacts that there is room for at first."""

Patches = dict[tuple[str, str], tuple[ContactPatch, ...]]


def surface_contacts(blocking: Blocking, touch: float) -> Patches:
    """Return the contacts of all pairs of bodies.

    Args:
        blocking: the bodies.
        touch: distance up to which surfaces that face each other touch [m].
    """
    found = {}
    for first, second in combinations(blocking.names, 2):
        if blocking.near(first, second, touch):
            surfaces = blocking.surfaces[first], blocking.surfaces[second]
            press = blocking.pressed.get(frozenset((first, second)), 0.0)
            if patches := _patches(*surfaces, touch, touch + press):
                found[first, second] = patches
    return found


def _patches(
    first: Surface, second: Surface, touch: float, deep: float
) -> tuple[ContactPatch, ...]:
    corners = _corners(first, second, touch, deep)
    if len(corners) == 0:
        return ()
    points, normals, gaps = corners[:, :3], corners[:, 3:6], corners[:, 6]
    chosen: list[Array] = []
    away = np.full(len(normals), np.inf)
    while len(chosen) < _MOST_NORMALS and away.max() > _ONE_PLANE:
        chosen.append(normals[int(away.argmax())])
        away = np.minimum(away, np.linalg.norm(normals - chosen[-1], axis=1))
    nearest = (normals @ np.array(chosen).T).argmax(axis=1)
    out = []
    for k, normal in enumerate(chosen):
        own = np.flatnonzero(nearest == k)
        bounds = _outermost(points[own], normal, _SIDES[len(chosen) > 1])
        out.append(ContactPatch(points[own][bounds], normal, float(gaps[own].min())))
    return tuple(out)


def _outermost(points: Array, normal: Array, sides: int) -> Indices:
    """Return the numbers of the points that bound others in directions perpendicular to a normal."""
    across = np.linalg.svd(normal[None, :])[2][1:]
    angles = 2.0 * np.pi * (np.arange(sides) + 0.5) / sides
    outward = np.column_stack([np.cos(angles), np.sin(angles)]) @ across
    return np.unique((points @ outward.T).argmax(axis=0))


def _corners(first: Surface, second: Surface, touch: float, deep: float) -> Array:
    """Return the corners of contacts, normals from the first to the second, and gaps, shape (n, 7)."""
    one, other = _rows(first), _rows(second)
    room = _ROOM
    while True:
        out = np.empty((room, 7))
        count = _facing_corners(*one, *other, touch, deep, out)
        if count <= room:
            return out[:count]
        room = count


def _rows(surface: Surface) -> tuple[Any, Any, Any, Any]:
    """Return the vertices, the corners of the triangles, their normals and the boxes around them."""
    tree = surface.tree
    view = view_of(tree, surface.vertices, np.ones(len(surface.faces), dtype=bool))
    normals = surface.normals[tree.order.ravel()]
    return view.points, view.corners, normals, view.boxes


@kernel
def _facing_corners(
    a_points: Array,
    a_corners: Indices,
    a_normals: Array,
    a_boxes: Array,
    b_points: Array,
    b_corners: Indices,
    b_normals: Array,
    b_boxes: Array,
    touch: float,
    deep: float,
    out: Array,
) -> int:
    """Write the corners of the overlaps of facing triangles, as far as there is room; return how many there are."""
    a_leaves, b_leaves = (len(a_boxes) + 1) // 2, (len(b_boxes) + 1) // 2
    a_size, b_size = len(a_corners) // a_leaves, len(b_corners) // b_leaves
    stack = np.empty((DEEPEST, 2), np.int64)
    first, second, frame = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    work, other, found = np.empty((10, 3)), np.empty((10, 3)), np.empty(3)
    stack[0, 0], stack[0, 1] = 0, 0
    top, count = 1, 0
    while top > 0:
        top -= 1
        i, k = stack[top, 0], stack[top, 1]
        apart = False
        for x in range(3):
            apart |= a_boxes[i, x] > b_boxes[k, 3 + x] + deep
            apart |= b_boxes[k, x] > a_boxes[i, 3 + x] + deep
        if apart:
            continue
        a_ends, b_ends = i >= a_leaves - 1, k >= b_leaves - 1
        if not a_ends or not b_ends:
            if b_ends or (not a_ends and i < k):
                stack[top, 0], stack[top, 1] = 2 * i + 1, k
                stack[top + 1, 0], stack[top + 1, 1] = 2 * i + 2, k
            else:
                stack[top, 0], stack[top, 1] = i, 2 * k + 1
                stack[top + 1, 0], stack[top + 1, 1] = i, 2 * k + 2
            top += 2
            continue
        for m in range((i - a_leaves + 1) * a_size, (i - a_leaves + 2) * a_size):
            nx, ny, nz = a_normals[m, 0], a_normals[m, 1], a_normals[m, 2]
            # Any two axes perpendicular to the normal.
            if abs(nx) < 0.6:
                ux, uy, uz = 0.0, nz, -ny
            else:
                ux, uy, uz = -nz, 0.0, nx
            length = np.sqrt(ux * ux + uy * uy + uz * uz)
            frame[0, 0], frame[0, 1], frame[0, 2] = (
                ux / length,
                uy / length,
                uz / length,
            )
            frame[2, 0], frame[2, 1], frame[2, 2] = nx, ny, nz
            frame[1, 0] = ny * frame[0, 2] - nz * frame[0, 1]
            frame[1, 1] = nz * frame[0, 0] - nx * frame[0, 2]
            frame[1, 2] = nx * frame[0, 1] - ny * frame[0, 0]
            for n in range((k - b_leaves + 1) * b_size, (k - b_leaves + 2) * b_size):
                cosine = (
                    nx * b_normals[n, 0] + ny * b_normals[n, 1] + nz * b_normals[n, 2]
                )
                if cosine > _FACING:
                    continue
                for c in range(3):
                    for x in range(3):
                        first[c, x], second[c, x] = 0.0, 0.0
                        for y in range(3):
                            p, q = a_corners[m, c], b_corners[n, c]
                            first[c, x] += frame[x, y] * a_points[p, y]
                            second[c, x] += frame[x, y] * b_points[q, y]
                corners = overlap_heights(first, second, 0.0, work, other, found)
                for c in range(corners):
                    # The normal of the first triangle is the third axis.
                    gap = work[c, 2] - first[0, 2]
                    if gap > touch or gap < -deep:
                        continue
                    if count < len(out):
                        for x in range(3):
                            out[count, x] = 0.0
                            for y in range(3):
                                out[count, x] += frame[y, x] * work[c, y]
                            out[count, 3 + x] = a_normals[m, x]
                        out[count, 6] = gap
                    count += 1
    return count
