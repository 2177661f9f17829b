"""Trees of boxes around triangles, and searches for pairs of triangles in compiled code.

A tree is complete and binary: boxes of level k are in rows 2**k - 1 to 2**(k + 1) - 2, the leaves are last. Each leaf
has as many triangles as any other; some triangles are there twice.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from planning.kernels import inner_kernel, kernel
from planning.transforms import Array, Indices

_LEAF = 4
"""Least number of triangles of a leaf."""

CERTAIN = 1e-7
"""What overlaps along a direction by less counts as touching [m]."""

_SLIVER = 1e-13
"""Smaller areas of overlap count as touching [m^2]."""

DEEPEST = 256
"""Rows of the stack of a search: more than one for each level of both trees are never needed."""


@dataclass(frozen=True, eq=False)
class TriangleTree:
    """Order of the triangles of a surface, such that neighbours are in the same boxes.

    Attributes:
        order: numbers of triangles, leaf by leaf, shape (leaves, n).
        corners: the vertices of these triangles, shape (leaves * n, 3).
    """

    order: Indices
    corners: Indices


def build_tree(vertices: Array, faces: Indices) -> TriangleTree:
    """Return the tree of the triangles of a surface, halved again and again along the longest side of a box."""
    middle = vertices[faces].mean(axis=1)
    levels = max(0, int(np.ceil(np.log2(len(faces) / _LEAF))))
    size = -(-len(faces) // 2**levels)
    order = np.resize(np.arange(len(faces)), 2**levels * size)[None]
    for _ in range(levels):
        points = middle[order]
        longest = np.ptp(points, axis=1).argmax(axis=1)
        along = np.take_along_axis(points, longest[:, None, None], axis=2)[:, :, 0]
        order = np.take_along_axis(order, along.argsort(axis=1, kind="stable"), axis=1)
        order = order.reshape(2 * len(order), -1)
    return TriangleTree(order, faces[order.ravel()])


@dataclass(frozen=True, eq=False)
class TriangleView:
    """Triangles of a surface in a frame, with boxes around those that count.

    Attributes:
        points: vertices, shape (v, 3) [m].
        corners: see ``TriangleTree``.
        counts: whether a triangle counts, shape (leaves * n,).
        boxes: least and greatest coordinates of the boxes, shape (2 * leaves - 1, 6) [m].
    """

    points: Array
    corners: Indices
    counts: Array
    boxes: Array


def view_of(tree: TriangleTree, points: Array, counts: Array) -> TriangleView:
    """Return the triangles of a tree, given its vertices in a frame, and which triangles count, shape (f,)."""
    leaves, size = tree.order.shape
    own = counts[tree.order.ravel()]
    triangles = points[tree.corners]
    low = np.where(own[:, None], triangles.min(axis=1), np.inf)
    high = np.where(own[:, None], triangles.max(axis=1), -np.inf)
    rows = [
        np.hstack(
            [
                low.reshape(leaves, size, 3).min(axis=1),
                high.reshape(leaves, size, 3).max(axis=1),
            ]
        )
    ]
    while len(rows[-1]) > 1:
        pair = rows[-1].reshape(-1, 2, 6)
        rows.append(np.hstack([pair[..., :3].min(axis=1), pair[..., 3:].max(axis=1)]))
    return TriangleView(points, tree.corners, own, np.vstack(rows[::-1]))


@inner_kernel
def overlap_heights(
    a: Array, b: Array, room: float, work: Array, other: Array, out: Array
) -> int:
    """Compare the heights of two triangles where one is above the other.

    Args:
        a, b: corners, the third coordinate is the height, shape (3, 3) [m].
        room: how much a is wider on all sides, in its plane but nowhere lower than it is [m].
        work, other: room for corners, shape (10, 3).
        out: takes the least and the greatest height of b above a [m], and the area of the overlap, shape (3,).

    Returns:
        The number of corners of their overlap, 0 for none; they are in ``work``, on b.
    """
    turn = (a[1, 0] - a[0, 0]) * (a[2, 1] - a[0, 1]) - (a[1, 1] - a[0, 1]) * (
        a[2, 0] - a[0, 0]
    )
    if turn == 0.0:
        return 0
    side = 1.0 if turn > 0.0 else -1.0
    count = 3
    for k in range(3):
        for x in range(3):
            work[k, x] = b[k, x]
    # Three edges, and with room the four sides of the box around them, since corners may be acute.
    for k in range(3 if room == 0.0 else 7):
        if k < 3:
            after = (k + 1) % 3
            px, py = a[k, 0], a[k, 1]
            ex, ey = side * (a[after, 0] - px), side * (a[after, 1] - py)
            margin = room * np.sqrt(ex * ex + ey * ey)
        else:
            sign = 1.0 if k < 5 else -1.0
            px, py = a[0, 0], a[0, 1]
            for c in range(1, 3):
                px = sign * min(sign * px, sign * a[c, 0])
                py = sign * min(sign * py, sign * a[c, 1])
            ex, ey = (sign, 0.0) if k % 2 == 1 else (0.0, -sign)
            margin = room
        kept = 0
        n = count - 1
        last = ex * (work[n, 1] - py) - ey * (work[n, 0] - px) + margin
        for n in range(count):
            here = ex * (work[n, 1] - py) - ey * (work[n, 0] - px) + margin
            if (here > 0.0) != (last > 0.0):
                before = n - 1 if n > 0 else count - 1
                share = last / (last - here)
                for x in range(3):
                    other[kept, x] = work[before, x] + share * (
                        work[n, x] - work[before, x]
                    )
                kept += 1
            if here > 0.0:
                for x in range(3):
                    other[kept, x] = work[n, x]
                kept += 1
            last = here
        count = kept
        for n in range(count):
            for x in range(3):
                work[n, x] = other[n, x]
        if count < 3:
            return 0
    lowest = min(a[0, 2], a[1, 2], a[2, 2])
    least, most, area = np.inf, -np.inf, 0.0
    for n in range(count):
        px, py = work[n, 0] - a[0, 0], work[n, 1] - a[0, 1]
        s = (px * (a[2, 1] - a[0, 1]) - py * (a[2, 0] - a[0, 0])) / turn
        t = ((a[1, 0] - a[0, 0]) * py - (a[1, 1] - a[0, 1]) * px) / turn
        below = a[0, 2] + s * (a[1, 2] - a[0, 2]) + t * (a[2, 2] - a[0, 2])
        height = work[n, 2] - max(below, lowest)
        least, most = min(least, height), max(most, height)
        m = n + 1 if n + 1 < count else 0
        area += 0.5 * (
            (work[n, 0] - work[0, 0]) * (work[m, 1] - work[0, 1])
            - (work[n, 1] - work[0, 1]) * (work[m, 0] - work[0, 0])
        )
    out[0], out[1], out[2] = least, most, abs(area)
    return count


def greatest_rise(lower: TriangleView, upper: TriangleView, room: float = 0.0) -> float:
    """Return by how much triangles of one view are at most higher than those of another in the same frame [m].

    Args:
        lower, upper: triangles in a frame whose third axis is the height.
        room: how much wider the triangles of the first are [m].

    Returns:
        The greatest height of the upper above the lower ones where they overlap; 0 if it is not positive.
    """
    found = _greatest_rise(*_arrays(lower), *_arrays(upper), room, np.inf, False)
    return float(found)


def rises_above(
    lower: TriangleView, upper: TriangleView, *, crosses: bool = False
) -> bool:
    """Return whether a triangle of one view is somewhere higher than one of another in the same frame.

    Args:
        lower, upper: triangles in a frame whose third axis is the height.
        crosses: whether the same two triangles must elsewhere be the other way about.
    """
    return _greatest_rise(*_arrays(lower), *_arrays(upper), 0.0, 0.0, crosses) > 0.0


def _arrays(view: TriangleView) -> tuple[Any, Any, Any, Any]:
    return view.points, view.corners, view.counts, view.boxes


@inner_kernel
def _take(points: Array, corners: Indices, row: int, out: Array) -> None:
    for k in range(3):
        for x in range(3):
            out[k, x] = points[corners[row, k], x]


@kernel
def _greatest_rise(
    a_points: Array,
    a_corners: Indices,
    a_counts: Array,
    a_boxes: Array,
    b_points: Array,
    b_corners: Indices,
    b_counts: Array,
    b_boxes: Array,
    room: float,
    enough: float,
    crosses: bool,
) -> float:
    """Return the greatest height of b above a, or one that is more than enough."""
    a_leaves, b_leaves = (len(a_boxes) + 1) // 2, (len(b_boxes) + 1) // 2
    a_size, b_size = len(a_corners) // a_leaves, len(b_corners) // b_leaves
    stack = np.empty((DEEPEST, 2), np.int64)
    first, second = np.empty((3, 3)), np.empty((3, 3))
    work, other, out = np.empty((10, 3)), np.empty((10, 3)), np.empty(3)
    stack[0, 0], stack[0, 1] = 0, 0
    top = 1
    best = CERTAIN
    while top > 0:
        top -= 1
        i, k = stack[top, 0], stack[top, 1]
        if (
            a_boxes[i, 0] >= b_boxes[k, 3] + room
            or b_boxes[k, 0] >= a_boxes[i, 3] + room
            or a_boxes[i, 1] >= b_boxes[k, 4] + room
            or b_boxes[k, 1] >= a_boxes[i, 4] + room
            or b_boxes[k, 5] - a_boxes[i, 2] <= best
            or (crosses and b_boxes[k, 2] >= a_boxes[i, 5])
        ):
            continue
        a_ends, b_ends = i >= a_leaves - 1, k >= b_leaves - 1
        if not a_ends or not b_ends:
            a_wide = a_boxes[i, 3] - a_boxes[i, 0] + a_boxes[i, 4] - a_boxes[i, 1]
            b_wide = b_boxes[k, 3] - b_boxes[k, 0] + b_boxes[k, 4] - b_boxes[k, 1]
            if b_ends or (not a_ends and a_wide > b_wide):
                stack[top, 0], stack[top, 1] = 2 * i + 1, k
                stack[top + 1, 0], stack[top + 1, 1] = 2 * i + 2, k
            else:
                stack[top, 0], stack[top, 1] = i, 2 * k + 1
                stack[top + 1, 0], stack[top + 1, 1] = i, 2 * k + 2
            top += 2
            continue
        for m in range((i - a_leaves + 1) * a_size, (i - a_leaves + 2) * a_size):
            if not a_counts[m]:
                continue
            _take(a_points, a_corners, m, first)
            for n in range((k - b_leaves + 1) * b_size, (k - b_leaves + 2) * b_size):
                if not b_counts[n]:
                    continue
                _take(b_points, b_corners, n, second)
                if (
                    overlap_heights(first, second, room, work, other, out) > 0
                    and out[1] > best
                    and out[2] > _SLIVER
                    and (not crosses or out[0] < -CERTAIN)
                ):
                    best = out[1]
                    if best > enough:
                        return best
    return best if best > CERTAIN else 0.0
