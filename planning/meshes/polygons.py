"""Polygons joined to larger ones that are convex but for shallow hollows."""

from __future__ import annotations

import heapq

import numpy as np

from planning.transforms import Array

Ring = tuple[int, ...]
"""Corners of a polygon by their numbers, counterclockwise."""

_ROUNDING = 1e-9
"""Hollows that are no deeper are none [m]."""


def joined_rings(points: Array, rings: list[Ring], within: float) -> list[Ring]:
    """Join neighbours while what comes out has only shallow hollows (after Hertel and Mehlhorn).

    Args:
        points: shape (c, 2) [m].
        rings: polygons that share edges, such as the triangles of an area.
        within: how deep a hollow may be [m].

    Returns:
        The corners of the convex hulls of what is left; those that have no width are left out.
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
    """Return two polygons as one, None where that goes around a hole.

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
    """Return how deep the deepest hollow of a polygon is."""
    hull = _hull(points, ring)
    at = [ring.index(corner) for corner in hull]
    deepest = 0.0
    for k, begin in enumerate(at):
        end = at[(k + 1) % len(at)]
        between = (
            ring[begin + 1 : end] if end > begin else ring[begin + 1 :] + ring[:end]
        )
        if between:
            way = points[ring[end]] - points[ring[begin]]
            off = points[list(between)] - points[ring[begin]]
            depth = np.abs(way[0] * off[:, 1] - way[1] * off[:, 0])
            deepest = max(deepest, float(depth.max() / np.hypot(*way)))
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
    """Tell whether the corners of a convex polygon are not all on one line."""
    at = points[list(hull)] - points[hull[0]]
    farthest = at[np.argmax(np.hypot(at[:, 0], at[:, 1]))]
    doubled = np.abs(farthest[0] * at[:, 1] - farthest[1] * at[:, 0]).max()
    return bool(doubled > _ROUNDING * np.hypot(*farthest))


def _turn(points: Array, a: int, b: int, c: int) -> float:
    one, other = points[b] - points[a], points[c] - points[a]
    return float(one[0] * other[1] - one[1] * other[0])
