"""Trees of boxes around triangles, and searches for pairs of triangles in compiled code.

A tree is complete and binary: boxes of level k are in rows 2**k - 1 to 2**(k + 1) - 2, the leaves are last. Each leaf
has as many triangles as any other; some triangles are there twice.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from planning.kernels import inner_kernel, kernel
from planning.transforms import Array, Indices

_LEAF = 4
"""Least number of triangles of a leaf."""

CERTAIN = 1e-7
"""What overlaps along a direction by less counts as touching [m]."""

_SLIVER = 1e-13
"""Smaller areas of overlap count as touching [m^2]."""

_CORNERS = 1024
"""Corners of contacts that there is room for at first."""

_DEEPEST = 256
"""Rows of the stack of a search: more than one for each level of both trees are never needed."""


@dataclass(frozen=True, eq=False)
class TriangleTree:
    """Numbers of the triangles of a surface, leaf by leaf, shape (leaves, n), and their vertices, shape (leaves * n, 3)."""

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


class TriangleView(NamedTuple):
    """Triangles of a surface in a frame whose third axis is the height, with boxes around those that count.

    Attributes:
        points: vertices, shape (v, 3) [m].
        corners: see ``TriangleTree``.
        counts: whether a triangle counts, shape (leaves * n,).
        boxes: least and greatest coordinates of the boxes, shape (2 * leaves - 1, 6) [m].
    """

    points: Array
    corners: Indices
    counts: npt.NDArray[np.bool_]
    boxes: Array


def view_of(
    tree: TriangleTree, points: Array, counts: npt.NDArray[np.bool_]
) -> TriangleView:
    """Return the triangles of a tree, given its vertices in a frame, and which triangles count, shape (f,)."""
    size = tree.order.shape[1]
    own = counts[tree.order.ravel()]
    triangles = points[tree.corners]
    low = np.where(own[:, None], triangles.min(axis=1), np.inf)
    high = np.where(own[:, None], triangles.max(axis=1), -np.inf)
    rows = [_joined(np.hstack([low, high]), size)]
    while len(rows[-1]) > 1:
        rows.append(_joined(rows[-1], 2))
    return TriangleView(points, tree.corners, own, np.vstack(rows[::-1]))


def _joined(boxes: Array, size: int) -> Array:
    """Return the boxes around so many boxes each."""
    groups = boxes.reshape(-1, size, 6)
    return np.hstack([groups[..., :3].min(axis=1), groups[..., 3:].max(axis=1)])


def greatest_rise(lower: TriangleView, upper: TriangleView, room: float) -> float:
    """Return by how much one view rises above another, no less, where they are no farther apart than some room [m].

    Triangles count as the boxes around them, which is exact for triangles of one height. 0 where it is not higher.
    """
    return float(_compare(lower, upper, room, np.inf, False, np.empty((0, 4))))


def rises_above(
    lower: TriangleView, upper: TriangleView, *, crosses: bool = False
) -> bool:
    """Return whether a triangle of one view is somewhere higher than one of another in the same frame.

    If it must cross that, the same two triangles are elsewhere the other way about.
    """
    return bool(_compare(lower, upper, 0.0, 0.0, crosses, np.empty((0, 4))) > 0.0)


def contact_corners(lower: TriangleView, upper: TriangleView, touch: float) -> Array:
    """Return the corners of the overlaps of triangles that are no farther apart, or deeper, along the height [m].

    They are on the upper triangles, each with its height above the lower one, shape (n, 4) [m].
    """
    out = np.empty((_CORNERS, 4))
    while (count := int(_compare(lower, upper, 0.0, touch, False, out))) > len(out):
        out = np.empty((count, 4))
    return out[:count]


@kernel
def _compare(
    a: TriangleView,
    b: TriangleView,
    room: float,
    enough: float,
    crosses: bool,
    found: Array,
) -> float:
    """Return the greatest height of b above a, or one that is more than enough; with room for corners, their number."""
    a_boxes, b_boxes = a.boxes, b.boxes
    a_leaves, b_leaves = (len(a_boxes) + 1) // 2, (len(b_boxes) + 1) // 2
    a_size, b_size = len(a.corners) // a_leaves, len(b.corners) // b_leaves
    stack = np.empty((_DEEPEST, 2), np.int64)
    first, second = np.empty((3, 3)), np.empty((3, 3))
    work, other = np.empty((9, 3)), np.empty((9, 3))
    stack[0, 0], stack[0, 1] = 0, 0
    top, count, touches = 1, 0, len(found) > 0
    best = -enough if touches else CERTAIN
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
            or (touches and b_boxes[k, 2] > a_boxes[i, 5] + enough)
        ):
            continue
        a_ends, b_ends = i >= a_leaves - 1, k >= b_leaves - 1
        if not a_ends or not b_ends:
            a_wide = a_boxes[i, 3] - a_boxes[i, 0] + a_boxes[i, 4] - a_boxes[i, 1]
            b_wide = b_boxes[k, 3] - b_boxes[k, 0] + b_boxes[k, 4] - b_boxes[k, 1]
            split = b_ends or (not a_ends and a_wide > b_wide)
            for child in range(2):
                stack[top, 0] = 2 * i + 1 + child if split else i
                stack[top, 1] = k if split else 2 * k + 1 + child
                top += 1
            continue
        for m in range((i - a_leaves + 1) * a_size, (i - a_leaves + 2) * a_size):
            for n in range((k - b_leaves + 1) * b_size, (k - b_leaves + 2) * b_size):
                if not a.counts[m] or not b.counts[n]:
                    continue
                for c in range(3):
                    for x in range(3):
                        first[c, x] = a.points[a.corners[m, c], x]
                        second[c, x] = b.points[b.corners[n, c], x]
                if room > 0.0:
                    best = max(best, _rise_of_boxes(first, second, room))
                    continue
                corners = _overlap(first, second, work, other)
                least, most, area = np.inf, -np.inf, 0.0
                for c in range(corners):
                    rise, after = other[c, 2], (c + 1) % corners
                    least, most = min(least, rise), max(most, rise)
                    area += (work[c, 0] - work[0, 0]) * (work[after, 1] - work[0, 1])
                    area -= (work[c, 1] - work[0, 1]) * (work[after, 0] - work[0, 0])
                    if touches and abs(rise) <= enough:
                        if count < len(found):
                            found[count, :3] = work[c]
                            found[count, 3] = rise
                        count += 1
                is_seen = 0.5 * abs(area) > _SLIVER and (
                    not crosses or least < -CERTAIN
                )
                if not touches and is_seen and most > best:
                    best = most
                    if best > enough:
                        return float(best)
    if touches:
        return float(count)
    return float(best) if best > CERTAIN else 0.0


@inner_kernel
def _rise_of_boxes(a: Array, b: Array, room: float) -> float:
    """Return how much higher than a the box around b reaches, 0 where they are farther apart across the height."""
    for x in range(2):
        low, high = a[:, x].min() - room, a[:, x].max() + room
        if b[:, x].min() > high or b[:, x].max() < low:
            return 0.0
    return float(b[:, 2].max() - a[:, 2].min())


@inner_kernel
def _overlap(a: Array, b: Array, work: Array, other: Array) -> int:
    """Compare the heights of two triangles where one is above the other.

    Args:
        a, b: corners, the third coordinate is the height, shape (3, 3) [m].
        work: takes the corners of the overlap, on b, shape (9, 3).
        other: takes their heights above a, in its third column, shape (9, 3).

    Returns:
        The number of corners, 0 for no overlap.
    """
    ux, uy = a[1, 0] - a[0, 0], a[1, 1] - a[0, 1]
    vx, vy = a[2, 0] - a[0, 0], a[2, 1] - a[0, 1]
    turn = ux * vy - uy * vx
    if turn == 0.0:
        return 0
    side = 1.0 if turn > 0.0 else -1.0
    count = 3
    work[:3] = b
    for k in range(3):
        after = (k + 1) % 3
        ex, ey = side * (a[after, 0] - a[k, 0]), side * (a[after, 1] - a[k, 1])
        kept = 0
        last = ex * (work[count - 1, 1] - a[k, 1]) - ey * (work[count - 1, 0] - a[k, 0])
        for n in range(count):
            here = ex * (work[n, 1] - a[k, 1]) - ey * (work[n, 0] - a[k, 0])
            if (here > 0.0) != (last > 0.0):
                before = n - 1 if n > 0 else count - 1
                for x in range(3):
                    step = work[n, x] - work[before, x]
                    other[kept, x] = work[before, x] + last / (last - here) * step
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
    for n in range(count):
        px, py = work[n, 0] - a[0, 0], work[n, 1] - a[0, 1]
        s, t = (px * vy - py * vx) / turn, (ux * py - uy * px) / turn
        below = a[0, 2] + s * (a[1, 2] - a[0, 2]) + t * (a[2, 2] - a[0, 2])
        other[n, 2] = work[n, 2] - below
    return count
