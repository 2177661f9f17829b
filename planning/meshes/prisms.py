"""Convex pieces of bodies whose faces are all along one direction or across it.

Such are plates, boards and milled housings. Between two of its heights the cross section of such
a body is the same everywhere, so its slices are prisms, and cutting them into convex pieces is
cutting polygons: exact, and a matter of milliseconds where a general search takes minutes.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import mapbox_earcut
import numpy as np
import numpy.typing as npt

from planning.meshes.polygons import Ring, joined_rings
from planning.transforms import Array, Indices

_FLAT = 1e-5
"""What stands out by less than this share of the size of its body is flat."""

_AXES = 3
"""Most directions that are tried."""

_SHARES = (1 / 64, 1 / 16, 1 / 4, 1.0)
"""Shares of the depth of hollows that are tried, the finest first."""

_FEW = 64
"""Finer pieces than have to be are made where they are no more than this."""


@dataclass(frozen=True, eq=False)
class _Slab:
    """A slice of a body that is a prism.

    Attributes:
        low, high: its heights [m].
        loops: outlines of its cross section and of the holes in that, each of shape (c, 2) [m].
    """

    low: float
    high: float
    loops: tuple[Array, ...]


def prism_pieces(
    vertices: Array, faces: Indices, within: float, most: int
) -> list[Array] | None:
    """Return the convex pieces of a body whose faces are along one direction or across it.

    Args:
        vertices: of a closed body, shape (v, 3) [m].
        faces: its triangles, shape (f, 3).
        within: how deep a hollow may be that a piece fills [m]; only shallower ones are filled
            where that makes few pieces.
        most: pieces there may be.

    Returns:
        Corners of the pieces, each of shape (c, 3) [m]; None where the body is no such body, or
        there would be too many.
    """
    for frame in _frames(vertices, faces):
        slabs = _slabs(vertices @ frame.T, faces)
        if slabs is None:
            continue
        for share in _SHARES:
            pieces = [
                _raised(flat, slab) @ frame
                for slab in slabs
                for flat in _convex_polygons(slab.loops, share * within)
            ]
            if len(pieces) <= (most if share == 1.0 else min(most, _FEW)):
                return pieces
    return None


def _frames(vertices: Array, faces: Indices) -> Iterator[Array]:
    """Yield frames, as rows, whose last axis has faces across it: the largest faces first."""
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normal, axis=1)
    unit = normal / np.maximum(area, 1e-300)[:, None]
    for _ in range(_AXES):
        if area.max() <= 0.0:
            return
        axis = unit[np.argmax(area)]
        area = np.where(np.abs(unit @ axis) > 1.0 - 1e-6, 0.0, area)
        side = np.cross(np.eye(3)[np.argmin(np.abs(axis))], axis)
        side /= np.linalg.norm(side)
        yield np.vstack([side, np.cross(axis, side), axis])


def _slabs(vertices: Array, faces: Indices) -> list[_Slab] | None:
    """Return the slices of a body along its third axis, None where these are no prisms."""
    tolerance = _FLAT * float(np.ptp(vertices, axis=0).max())
    corners = vertices[faces]
    across = np.ptp(corners[:, :, 2], axis=1) <= tolerance
    edges = np.roll(corners, -1, axis=1) - corners
    longest = np.linalg.norm(edges[:, :, :2], axis=2).max(axis=1)
    doubled = edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0]
    if np.any(~across & (np.abs(doubled) > tolerance * longest)):
        return None
    if not across.any():
        return None
    heights = np.sort(corners[across][:, :, 2].ravel())
    new = np.append(True, np.diff(heights) > tolerance)
    levels = heights[new]
    out = []
    for low, high in pairwise(levels.tolist()):
        loops = _section(vertices, faces, 0.5 * (low + high))
        if loops is None:
            return None
        out.append(_Slab(low, high, tuple(loops)))
    return out


def _section(vertices: Array, faces: Indices, height: float) -> list[Array] | None:
    """Return the outlines of a body at a height that none of its vertices needs to avoid.

    Returns:
        Closed polygons, each of shape (c, 2); None where the body is not closed there.
    """
    above = vertices[:, 2] >= height
    links: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for face in faces[above[faces].any(axis=1) & ~above[faces].all(axis=1)].tolist():
        crossed = [
            (min(a, b), max(a, b))
            for a, b in zip(face, face[1:] + face[:1], strict=True)
            if above[a] != above[b]
        ]
        one, other = crossed
        links.setdefault(one, []).append(other)
        links.setdefault(other, []).append(one)
    if any(len(ends) != 2 for ends in links.values()):
        return None
    loops = []
    while links:
        first = next(iter(links))
        loop, edge = [first], links.pop(first)[0]
        while edge != first:
            loop.append(edge)
            one, other = links.pop(edge)
            edge = other if one == loop[-2] else one
        ends = vertices[np.array(loop)]
        share = (height - ends[:, 0, 2]) / (ends[:, 1, 2] - ends[:, 0, 2])
        points = ends[:, 0] + share[:, None] * (ends[:, 1] - ends[:, 0])
        loops.append(points[:, :2])
    return loops


def _convex_polygons(loops: tuple[Array, ...], within: float) -> Iterator[Array]:
    """Yield convex polygons that cover an area, each of shape (c, 2).

    Args:
        loops: outlines of the area and of its holes.
        within: how deep a hollow may be that a polygon fills.
    """
    inside = np.array([[_holds(a, b[0]) for b in loops] for a in loops])
    np.fill_diagonal(inside, False)
    depth = inside.sum(axis=0)
    for outer in np.flatnonzero(depth % 2 == 0):
        holes = np.flatnonzero(inside[outer] & (depth == depth[outer] + 1))
        own = [loops[k] for k in (outer, *holes)]
        points = np.vstack(own)
        ends = np.cumsum([len(loop) for loop in own]).astype(np.uint32)
        triangles = mapbox_earcut.triangulate_float64(points, ends).reshape(-1, 3)
        for ring in joined_rings(points, _counterclockwise(points, triangles), within):
            yield points[list(ring)]


def _holds(loop: Array, point: Array) -> bool:
    """Tell whether a polygon goes around a point."""
    after = np.roll(loop, -1, axis=0)
    crosses = (loop[:, 1] > point[1]) != (after[:, 1] > point[1])
    a, b = loop[crosses], after[crosses]
    x = a[:, 0] + (point[1] - a[:, 1]) / (b[:, 1] - a[:, 1]) * (b[:, 0] - a[:, 0])
    return bool(np.count_nonzero(x > point[0]) % 2)


def _counterclockwise(points: Array, triangles: npt.NDArray[np.uint32]) -> list[Ring]:
    """Return triangles as rings that go around counterclockwise."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    doubled = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    rings = np.where((doubled < 0.0)[:, None], triangles[:, ::-1], triangles)
    return [tuple(ring) for ring in rings.astype(int).tolist()]


def _raised(flat: Array, slab: _Slab) -> Array:
    """Return the corners of a prism over a polygon."""
    heights = np.repeat([slab.low, slab.high], len(flat))
    return np.column_stack([np.vstack([flat, flat]), heights])
