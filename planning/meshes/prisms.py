"""Convex pieces of prismatic bodies, whose faces are all parallel or perpendicular to one direction.

Examples are plates, boards and milled housings. The cross section of such a body is constant between two consecutive
heights of its faces, so the body consists of prisms. The polygons of the cross sections are divided into convex ones.
This is exact and takes milliseconds instead of the minutes of a general decomposition.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import mapbox_earcut
import numpy as np
import numpy.typing as npt

from planning.transforms import Array, Indices

Ring = tuple[int, ...]
"""Corners of a polygon by their numbers, counterclockwise."""

_ROUNDING = 1e-9
"""Hollows that are no deeper than this are ignored [m]."""

_FLAT = 1e-5
"""A surface is flat if it deviates from a plane by less than this share of the body's size."""

_AXES = 3
"""Greatest number of normals of large triangles that are tried as the direction."""

_SLOW_TO_SEARCH = 1000
"""A general search takes long for a body with at least this many triangles."""

_SHARES = (1 / 64, 1 / 16, 1 / 4, 1.0)
"""Shares of the allowed depth of hollows that are tried, the finest first."""

_MOST_FINE_PIECES = 64
"""Greatest number of pieces that a finer share may make."""


def _merge_convex_rings(points: Array, rings: list[Ring], within: float) -> list[Ring]:
    """Join neighbours while the union has only shallow hollows (after Hertel and Mehlhorn).

    Args:
        points: shape (c, 2) [m].
        rings: polygons that share edges, such as the triangles of an area.
        within: greatest depth of a hollow [m].

    Returns:
        The corners of the convex hulls of the joined polygons, without those that have no width.
    """
    polygons = dict(enumerate(rings))
    owner = {edge: k for k, ring in polygons.items() for edge in _edges(ring)}
    # The longest common edges first: what is cut by them is large.
    waiting = [
        (-float(np.hypot(*(points[a] - points[b]))), a, b)
        for a, b in owner
        if a < b and (b, a) in owner
    ]
    heapq.heapify(waiting)
    while waiting:
        _, a, b = heapq.heappop(waiting)
        one, other = owner.get((a, b)), owner.get((b, a))
        if one is None or other is None or one == other:
            continue
        joined = _joined(polygons[one], polygons[other], (a, b))
        if joined is None or _deepest(points, joined) > max(within, _ROUNDING):
            continue
        for edge in (*_edges(polygons[one]), *_edges(polygons.pop(other))):
            del owner[edge]
        polygons[one] = joined
        owner.update(dict.fromkeys(_edges(joined), one))
    hulls = [tuple(_hull(points, ring)) for ring in polygons.values()]
    return [hull for hull in hulls if _is_wide(points, hull)]


def _edges(ring: Ring) -> list[tuple[int, int]]:
    return list(zip(ring, ring[1:] + ring[:1], strict=True))


def _joined(one: Ring, other: Ring, edge: tuple[int, int]) -> Ring | None:
    """Return the union of two polygons, None where it encloses a hole.

    Args:
        one: has the edge.
        other: has it the other way round.
        edge: that both have.
    """
    a, b = edge
    at, there = one.index(b), other.index(a)
    # From b all around to a, then back to b along the other.
    ring = [*one[at:], *one[:at], *(other[there:] + other[:there])[1:-1]]
    k = 0
    while k < len(ring) and len(ring) > 2:
        # There and back again along an edge that both have as well.
        if ring[k - 1] == ring[(k + 1) % len(ring)]:
            for gone in sorted({k, (k + 1) % len(ring)}, reverse=True):
                del ring[gone]
            k = 0
        else:
            k += 1
    return tuple(ring) if len(set(ring)) == len(ring) > 2 else None


def _deepest(points: Array, ring: Ring) -> float:
    """Return the depth of the deepest hollow of a polygon."""
    hull = _hull(points, ring)
    at = [ring.index(corner) for corner in hull]
    deepest = 0.0
    for k, begin in enumerate(at):
        end = at[(k + 1) % len(at)]
        between = (
            ring[begin + 1 : end] if end > begin else ring[begin + 1 :] + ring[:end]
        )
        if between:
            edge = points[ring[end]] - points[ring[begin]]
            off = points[list(between)] - points[ring[begin]]
            depth = np.abs(edge[0] * off[:, 1] - edge[1] * off[:, 0])
            deepest = max(deepest, float(depth.max() / np.hypot(*edge)))
    return deepest


def _hull(points: Array, ring: Ring) -> list[int]:
    """Return the corners of the convex hull of a polygon, counterclockwise."""
    order = sorted(ring, key=lambda k: (points[k, 0], points[k, 1]))

    def half(corners: list[int]) -> list[int]:
        out: list[int] = []
        for c in corners:
            while len(out) > 1 and _turn(points, out[-2], out[-1], c) <= 0.0:
                out.pop()
            out.append(c)
        return out[:-1]

    return half(order) + half(order[::-1])


def _is_wide(points: Array, hull: Ring) -> bool:
    """Tell whether the corners of a convex polygon are not collinear."""
    at = points[list(hull)] - points[hull[0]]
    farthest = at[np.argmax(np.hypot(at[:, 0], at[:, 1]))]
    doubled = np.abs(farthest[0] * at[:, 1] - farthest[1] * at[:, 0]).max()
    return bool(doubled > _ROUNDING * np.hypot(*farthest))


def _turn(points: Array, a: int, b: int, c: int) -> float:
    one, other = points[b] - points[a], points[c] - points[a]
    return float(one[0] * other[1] - one[1] * other[0])


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
    """Return the convex pieces of a body with faces parallel or perpendicular to one direction only.

    Args:
        vertices: of a closed body, shape (v, 3) [m].
        faces: its triangles, shape (f, 3).
        within: greatest depth of a hollow that a piece may fill [m]; a smaller depth is used if the number of pieces
            is still small.
        most: greatest number of pieces.

    Returns:
        Corners of the pieces, each of shape (c, 3) [m]; None if the body is not prismatic, or there would be too many
        pieces.
    """
    for number, frame in enumerate(_frames(vertices, faces)):
        # For a small body, the last direction is only used if few fine prisms result: a general search is fast.
        last = number == _AXES and len(faces) < _SLOW_TO_SEARCH
        few = min(most, _MOST_FINE_PIECES // 2 if last else _MOST_FINE_PIECES)
        slabs = _slabs(vertices @ frame.T, faces)
        if slabs is None:
            continue
        for share in _SHARES[:1] if last else _SHARES:
            pieces = [
                _raised(flat, slab) @ frame
                for slab in slabs
                for flat in _convex_polygons(slab.loops, share * within)
            ]
            if len(pieces) <= (most if share == 1.0 else few):
                return pieces
    return None


def _frames(vertices: Array, faces: Indices) -> Iterator[Array]:
    """Yield frames, as rows, whose last axis is normal to some faces: the largest triangles first."""
    corners = vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    doubled = np.linalg.norm(normal, axis=1)
    unit, area = normal / np.maximum(doubled, 1e-300)[:, None], doubled
    tried: list[Array] = []
    for _ in range(_AXES):
        if area.max() <= 0.0:
            break
        tried.append(unit[np.argmax(area)])
        area = np.where(np.abs(unit @ tried[-1]) > 1.0 - 1e-6, 0.0, area)
    # The end face of a bar with many sides is larger than each side, but may consist of many small triangles.
    sign = np.sign(np.take_along_axis(unit, np.abs(unit).argmax(axis=1)[:, None], 1))
    facing, own = np.unique(np.round(unit * sign, 6), axis=0, return_inverse=True)
    whole = facing[np.argmax(np.bincount(own.reshape(-1), doubled))]
    axis = unit[np.argmax(np.abs(unit @ whole))]
    if tried and all(abs(axis @ other) <= 1.0 - 1e-6 for other in tried):
        tried.append(axis)
    for axis in tried:
        side = np.cross(np.eye(3)[np.argmin(np.abs(axis))], axis)
        side /= np.linalg.norm(side)
        yield np.vstack([side, np.cross(axis, side), axis])


def _slabs(vertices: Array, faces: Indices) -> list[_Slab] | None:
    """Return the slices of a body along its third axis; None if they are not prisms."""
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
    """Return the outlines of a body at a height.

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
        for ring in _merge_convex_rings(
            points, _counterclockwise(points, triangles), within
        ):
            yield points[list(ring)]


def _holds(loop: Array, point: Array) -> bool:
    """Tell whether a polygon contains a point."""
    after = np.roll(loop, -1, axis=0)
    crosses = (loop[:, 1] > point[1]) != (after[:, 1] > point[1])
    a, b = loop[crosses], after[crosses]
    x = a[:, 0] + (point[1] - a[:, 1]) / (b[:, 1] - a[:, 1]) * (b[:, 0] - a[:, 0])
    return bool(np.count_nonzero(x > point[0]) % 2)


def _counterclockwise(points: Array, triangles: npt.NDArray[np.uint32]) -> list[Ring]:
    """Return triangles as counterclockwise rings."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    doubled = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    rings = np.where((doubled < 0.0)[:, None], triangles[:, ::-1], triangles)
    return [tuple(ring) for ring in rings.astype(int).tolist()]


def _raised(flat: Array, slab: _Slab) -> Array:
    """Return the corners of a prism over a polygon."""
    heights = np.repeat([slab.low, slab.high], len(flat))
    return np.column_stack([np.vstack([flat, flat]), heights])
