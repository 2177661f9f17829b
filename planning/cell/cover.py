"""Bounding capsules of a convex hull: several capsules where a single one would be a loose bound.

A grid of planes divides the hull into convex cells. One capsule contains all corners of a cell. A capsule is convex,
so it contains the whole cell, and the union of the capsules contains the hull.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from functools import lru_cache
from itertools import product

import numpy as np
import numpy.typing as npt
from scipy.spatial import ConvexHull, QhullError

from planning.caches import Arrays, load_or_compute
from planning.cell.body import Capsules, ConvexBody
from planning.transforms import Array, read_only_copy

_ROUNDING = 1e-9
"""Added to every radius [m]: more than all rounding in the cuts at metre scale."""

_MOST_BOX_TILES = 40
"""Capsules of a box, side by side along its middle axis."""

_MANY = 10_000
"""Segments between corners on both sides of a cut, of which more are not looked at one by one."""

_Segment = tuple[Array, Array, float]
_NAMES = frozenset({"counts", "rows"})


def capsule_cover(
    vertices: npt.ArrayLike,
    *,
    tolerance: float = 0.015,
    most: int = 4,
    thrift: float = 0.5,
) -> Capsules:
    """Bound a convex hull by capsules.

    Of all grids with up to ``most`` cells the one is chosen that exceeds it least for its size:
    ``n`` capsules must pay by a cover ``n ** thrift`` times as tight, down to ``tolerance``.

    Args:
        vertices: points whose hull is covered, shape (v, 3) [m].
        tolerance: a cover that stands out of the hull by less is tight enough [m].
        most: largest number of capsules.
        thrift: 0 takes the tightest grid, 1 hardly ever more than one capsule.

    Returns:
        Capsules in the frame of ``vertices``; their union contains the hull.
    """
    corners = np.ascontiguousarray(vertices, dtype=np.float64).reshape(-1, 3)
    return _cover(corners.tobytes(), tolerance, most, thrift)


def capsule_covers(
    hulls: Sequence[Array], *, thrift: float = 0.5
) -> tuple[Capsules, ...]:
    """Bound convex hulls by capsules, each as capsule_cover does; cached on disk.

    Args:
        hulls: corners of each, shape (v, 3) [m].
        thrift: see capsule_cover.

    Returns:
        The capsules of each hull, in its frame.
    """
    corners = [np.ascontiguousarray(hull, dtype=np.float64) for hull in hulls]
    sizes = [len(own) for own in corners]
    question = [repr((thrift, sizes)).encode(), *(c.tobytes() for c in corners)]

    def find() -> Arrays:
        covers = [capsule_cover(own, thrift=thrift) for own in corners]
        return {
            "counts": np.array([len(c.radius) for c in covers], dtype=np.int64),
            "rows": np.vstack([_rows(c) for c in covers] or [np.empty((0, 7))]),
        }

    known = load_or_compute("covers", b"".join(question), _NAMES, find, [__file__])
    ends = np.cumsum(known["counts"])[:-1]
    return tuple(
        Capsules(
            read_only_copy(own[:, :3]),
            read_only_copy(own[:, 3:6]),
            read_only_copy(own[:, 6]),
        )
        for own in np.split(known["rows"], ends)[: len(corners)]
    )


def _rows(capsules: Capsules) -> Array:
    return np.column_stack([capsules.start, capsules.end, capsules.radius])


# Robots of a kind, and parts of a kind, have the same hulls.
@lru_cache(maxsize=4096)
def _cover(corners: bytes, tolerance: float, most: int, thrift: float) -> Capsules:
    points = hull_vertices(np.frombuffer(corners).reshape(-1, 3))
    axes = _tightest_axes(points)
    local = points @ axes
    normals = sphere_directions()
    # Grids are compared on a sketch of the hull; the one chosen is cut from all of it.
    sketch = local[np.unique((local @ sphere_directions(40).T).argmax(axis=0))]
    support = (sketch @ normals.T).max(axis=0)
    sides = range(1, most + 1)
    chosen, least = (1, 1, 1), np.inf
    for grid in ((i, j, k) for i in sides for j in sides for k in sides):
        count = int(np.prod(grid))
        if count > most:
            continue
        segments = [_capsule(cell, normals, support) for cell in _cells(sketch, grid)]
        excess = _excess(segments, normals, support)
        score = max(excess, tolerance) * count**thrift + 1e-3 * excess
        if score < least:
            chosen, least = grid, score
    support = (local @ normals.T).max(axis=0)
    segments = [_capsule(cell, normals, support) for cell in _cells(local, chosen)]
    return _capsules(segments, axes)


def box_body(name: str, size: npt.ArrayLike) -> ConvexBody:
    """Return a box centred at the origin, its middle axis tiled by the shortest one.

    Args:
        name: unique within what carries the box.
        size: edge lengths, shape (3,), all positive [m].

    Raises:
        ValueError: an edge is not a positive finite number.
    """
    edges = np.asarray(size, dtype=np.float64)
    if edges.shape != (3,) or not np.all(np.isfinite(edges)) or np.any(edges <= 0.0):
        raise ValueError(f"box {name!r} needs three positive edge lengths, got {edges}")
    vertices, capsules = _box(float(edges[0]), float(edges[1]), float(edges[2]))
    return ConvexBody(name, vertices, capsules)


def hull_vertices(vertices: npt.ArrayLike) -> Array:
    """Return the extreme points of a cloud, shape (v, 3), also of one in a plane or on a line."""
    points = np.unique(np.asarray(vertices, dtype=np.float64), axis=0)
    if len(points) < 5:
        return points
    with suppress(QhullError):
        return np.asarray(points[ConvexHull(points).vertices])
    # All points lie in one plane, or nearly so: their corners are those of their image in it.
    middle = points.mean(axis=0)
    plane = np.linalg.svd(points - middle, full_matrices=False)[2]
    image = (points - middle) @ plane.T
    with suppress(QhullError):
        return np.asarray(points[np.sort(ConvexHull(image[:, :2]).vertices)])
    return np.asarray(points[[image[:, 0].argmin(), image[:, 0].argmax()]])


@lru_cache(maxsize=256)
def _box(x: float, y: float, z: float) -> tuple[Array, Capsules]:
    size = np.array([x, y, z])
    vertices = read_only_copy(list(product(*((-s / 2, s / 2) for s in size))))
    short, middle, _ = np.argsort(size, kind="stable")
    counts = [1, 1, 1]
    tiles = round(float(size[middle] / size[short]))
    counts[middle] = min(max(tiles, 1), _MOST_BOX_TILES)
    normals = sphere_directions()
    support = (vertices @ normals.T).max(axis=0)
    segments = [
        _capsule(cell, normals, support)
        for cell in _cells(vertices, (counts[0], counts[1], counts[2]))
    ]
    return vertices, _capsules(segments, np.eye(3))


def cut_along_axis(vertices: npt.ArrayLike, axis: int, count: int) -> list[Array]:
    """Cut a convex hull into pieces of equal extent along a coordinate axis.

    Args:
        vertices: points whose hull is cut, shape (v, 3) [m].
        axis: 0, 1 or 2.
        count: number of pieces.

    Returns:
        The corners of each piece, those on the cuts included.
    """
    counts = [1, 1, 1]
    counts[axis] = count
    return _cells(hull_vertices(vertices), (counts[0], counts[1], counts[2]))


def sphere_directions(count: int = 300) -> Array:
    """Return unit vectors spread over the sphere, the coordinate axes among them."""
    k = np.arange(count) + 0.5
    z = 1.0 - 2.0 * k / count
    angle = np.pi * (1.0 + np.sqrt(5.0)) * k
    ring = np.sqrt(1.0 - z * z)
    spread = np.column_stack([ring * np.cos(angle), ring * np.sin(angle), z])
    return np.vstack([spread, np.eye(3), -np.eye(3)])


def _tightest_axes(points: Array) -> Array:
    """Return orthonormal axes (columns): coordinate or principal, the tighter box wins."""
    centred = points - points.mean(axis=0)
    principal = np.linalg.svd(centred, full_matrices=len(points) < 3)[2].T
    frames = (np.eye(3), principal)
    volumes = [np.prod(np.ptp(points @ axes, axis=0) + 1e-6) for axes in frames]
    return frames[1] if volumes[1] < 0.98 * volumes[0] else frames[0]


def _cells(points: Array, counts: tuple[int, int, int]) -> list[Array]:
    """Cut the hull of ``points`` into a grid; return the corners of every non-empty cell."""
    cells = [points]
    for axis, count in enumerate(counts):
        low, high = points[:, axis].min(), points[:, axis].max()
        for cut in np.linspace(low, high, count + 1)[1:-1]:
            last = cells
            cells = []
            for cell in last:
                below, above = _cut(cell, axis, float(cut))
                cells += [part for part in (below, above) if len(part)]
    return cells


def _cut(points: Array, axis: int, level: float) -> tuple[Array, Array]:
    """Cut a hull in two; the corners of either half are its points and those on the cut.

    Every corner of the cut polygon lies on an edge of the hull, so on a segment between a
    point below and one above: taking all such segments misses none and adds none outside. Where
    there are very many, those of the hull's edges are found first.
    """
    height = points[:, axis] - level
    below, above = points[height <= 0.0], points[height >= 0.0]
    low, high = points[height < 0.0], points[height > 0.0]
    if not len(low) or not len(high):
        empty = np.empty((0, 3))
        return (points, empty) if len(low) else (empty, points)
    starts, ends = np.repeat(low, len(high), 0), np.tile(high, (len(low), 1))
    if len(starts) > _MANY:
        with suppress(QhullError):
            starts, ends = _edges_across(points, height)
    a, b = level - starts[:, axis], ends[:, axis] - level
    share = (a / (a + b))[:, None]
    crossing = starts * (1.0 - share) + ends * share
    crossing[:, axis] = level
    return (
        hull_vertices(np.vstack([below, crossing])),
        hull_vertices(np.vstack([above, crossing])),
    )


def _edges_across(points: Array, height: Array) -> tuple[Array, Array]:
    """Return the ends of edges of a hull with one end below and one above, the lower ends first."""
    corners = ConvexHull(points).simplices
    pairs = np.vstack([corners[:, [i, j]] for i, j in ((0, 1), (1, 2), (2, 0))])
    pairs = np.vstack([pairs, pairs[:, ::-1]])
    pairs = np.unique(
        pairs[(height[pairs[:, 0]] < 0.0) & (height[pairs[:, 1]] > 0.0)], axis=0
    )
    return points[pairs[:, 0]], points[pairs[:, 1]]


def _capsule(points: Array, normals: Array, support: Array) -> _Segment:
    """Return the capsule along the longest axis that contains ``points`` and exceeds them least."""
    long = int(np.argmax(np.ptp(points, axis=0)))
    others = [i for i in range(3) if i != long]
    centre = _circle_centre(points[:, others])
    along = points[:, long]
    radial = np.linalg.norm(points[:, others] - centre, axis=1)
    radii = np.maximum(radial.max(), 1e-9) * np.linspace(1.0, 1.6, 25)
    # A point is inside when the segment reaches within `reach` of its foot.
    reach = np.sqrt(np.maximum(radii[:, None] ** 2 - radial**2, 0.0))
    first, last = (along + reach).min(axis=1), (along - reach).max(axis=1)
    middle = (first + last) / 2.0
    first, last = np.minimum(first, middle), np.maximum(last, middle)
    # The radius that counts is measured again on the segment as it is stored.
    offset = along - np.clip(along, first[:, None], last[:, None])
    radii = np.sqrt(offset**2 + radial**2).max(axis=1) + _ROUNDING
    starts = np.empty((len(radii), 3))
    starts[:, others], starts[:, long] = centre, first
    ends = starts.copy()
    ends[:, long] = last
    excess = _excess_each(starts, ends, radii, normals, support)
    volume = radii**2 * (last - first + 4.0 / 3.0 * radii)
    best = np.lexsort((volume, excess))[0]
    return starts[best], ends[best], float(radii[best])


def _circle_centre(points: Array) -> Array:
    """Return a point near the centre of the smallest circle (Badoiu and Clarkson)."""
    centre = (points.min(axis=0) + points.max(axis=0)) / 2.0
    best, radius = centre, np.linalg.norm(points - centre, axis=1).max()
    for k in range(1, 30):
        distance = np.linalg.norm(points - centre, axis=1)
        far = int(np.argmax(distance))
        if distance[far] < radius:
            best, radius = centre, distance[far]
        centre = centre + (points[far] - centre) / (k + 1.0)
    return np.asarray(best)


def _excess(segments: list[_Segment], normals: Array, support: Array) -> float:
    starts, ends, radii = (np.array(column) for column in zip(*segments, strict=True))
    return float(_excess_each(starts, ends, radii, normals, support).max())


def _excess_each(
    starts: Array, ends: Array, radii: Array, normals: Array, support: Array
) -> Array:
    reach = np.maximum(starts @ normals.T, ends @ normals.T) + radii[:, None]
    return np.asarray((reach - support).max(axis=1))


def _capsules(segments: list[_Segment], axes: Array) -> Capsules:
    return Capsules(
        read_only_copy(np.array([s for s, _, _ in segments]) @ axes.T),
        read_only_copy(np.array([e for _, e, _ in segments]) @ axes.T),
        read_only_copy([r for _, _, r in segments]),
    )
