"""What is occupied, segment after segment, with a binary tree of bounding blocks over it.

A block bounds a run of consecutive segments twice: by one box, and capsule by capsule. The
capsules of a leaf stand where the joints are in the middle of all they do in it, grown by a
rigorous bound of how far they get from there; those of a larger block are those of one of
its halves, grown until they hold the other's. Capsules of single segments are not kept: what
they could tell the hulls tell better.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from planning.geometry.hull_table import AT_REST, HullTable
from planning.geometry.stretches import (
    MIXED,
    Stretch,
    make_stretch,
    measure_stray,
    pose_stretch,
)
from planning.transforms import Array
from scheduling.temporal_plan_graph import Indices

LEAF = 8
"""Segments in a block that is not split any further."""

INACTIVE = -1.0
"""Radius of a capsule that is not there."""


class SweptSequence(NamedTuple):
    """Segments in order, and blocks of them; block b has the children 2b + 1 and 2b + 2.

    Attributes:
        node: node of each segment, never falling, shape (s,).
        task, other_task: tasks of each segment, see ``may_touch``, never falling, shape (s,).
        entity: entity of each body, -1 where there is none, shape (s, bodies).
        column: where the capsules of each body begin, shape (bodies + 1,).
        block_first, block_last: segments of each block, ``range(first, last)``, shape (b,).
        block_low, block_high: box around each block, shape (b, 3) [m].
        block_start, block_end: world ends of the capsules, shape (b, c, 3) [m].
        block_radius: their radii, shape (b, c) [m]; INACTIVE where there is none.
    """

    node: Indices
    task: Indices
    other_task: Indices
    entity: npt.NDArray[np.int32]
    column: Indices
    block_first: Indices
    block_last: Indices
    block_low: Array
    block_high: Array
    block_start: Array
    block_end: Array
    block_radius: Array


def swept_sequence(
    node: Indices,
    task: Indices,
    other_task: Indices,
    entity: npt.NDArray[np.int32],
    hulls: HullTable,
    *,
    leaf: int = LEAF,
) -> SweptSequence:
    """Build the tree over a sequence of at least one segment.

    Args:
        node, task, other_task, entity: see SweptSequence.
        hulls: the bodies in motion.
        leaf: most segments in a leaf, up to LEAF; 1 where they have nothing in common.
    """
    count = len(node)
    leaves = 1
    while leaves * leaf < count:
        leaves *= 2
    blocks = 2 * leaves - 1
    widths = np.append(np.diff(hulls.capsule_first), 0)  # the last one stands for none
    column = np.cumsum([0, *np.max(widths[hulls.solid], axis=0)]).astype(np.int64)
    capsules = int(column[-1])
    out = SweptSequence(
        np.ascontiguousarray(node, dtype=np.int64),
        np.ascontiguousarray(task, dtype=np.int64),
        np.ascontiguousarray(other_task, dtype=np.int64),
        np.ascontiguousarray(entity, dtype=np.int32),
        column,
        np.zeros(blocks, dtype=np.int64),
        np.zeros(blocks, dtype=np.int64),
        np.full((blocks, 3), np.inf),
        np.full((blocks, 3), -np.inf),
        np.zeros((blocks, capsules, 3)),
        np.zeros((blocks, capsules, 3)),
        np.full((blocks, capsules), INACTIVE),
    )
    _build(out, hulls, leaves, make_stretch(hulls))
    return out


@njit(cache=True)
def _build(seq: SweptSequence, hulls: HullTable, leaves: int, room: Stretch) -> None:
    count = len(seq.node)
    size = (count + leaves - 1) // leaves
    for i in range(leaves):
        block = leaves - 1 + i
        first, last = min(i * size, count), min((i + 1) * size, count)
        seq.block_first[block], seq.block_last[block] = first, last
        if first < last:
            bound_leaf(seq, hulls, block, room)
    for block in range(leaves - 2, -1, -1):
        left, right = 2 * block + 1, 2 * block + 2
        seq.block_first[block] = seq.block_first[left]
        seq.block_last[block] = max(seq.block_last[left], seq.block_last[right])
        for k in range(3):
            seq.block_low[block, k] = min(
                seq.block_low[left, k], seq.block_low[right, k]
            )
            seq.block_high[block, k] = max(
                seq.block_high[left, k], seq.block_high[right, k]
            )
        _bound_both(
            seq.block_start, seq.block_end, seq.block_radius, block, left, right
        )


@njit(cache=True)
def bound_leaf(seq: SweptSequence, hulls: HullTable, block: int, room: Stretch) -> None:
    """Write the capsules and the box of a block from its segments."""
    first, last = seq.block_first[block], seq.block_last[block]
    pose_stretch(hulls, first, last, room)
    start, end = seq.block_start[block], seq.block_end[block]
    radius = seq.block_radius[block]
    ends, radii, joints = hulls.ends, hulls.radius, hulls.joint
    capsule_first, strays = hulls.capsule_first, room.strays
    at_start, at_middle, at_end = room.start, room.middle, room.end
    for i in range(hulls.solid.shape[1]):
        solid = int(room.solid[i])
        c = seq.column[i]
        if solid != MIXED:
            if solid >= 0:
                _sweep_capsules(
                    ends,
                    radii,
                    capsule_first[solid],
                    capsule_first[solid + 1],
                    joints[solid],
                    at_start,
                    at_middle,
                    at_end,
                    strays,
                    solid,
                    start,
                    end,
                    radius,
                    c,
                )
            continue
        # Objects that come and go: the first capsule becomes a ball around them all.
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        before = -1
        for s in range(first, last):
            solid = int(hulls.solid[s, i])
            if solid >= 0 and solid != before:
                measure_stray(hulls, solid, room)
                count = place_capsules(
                    hulls, solid, room, start[c:], end[c:], radius[c:]
                )
                for e in range(c, c + count):
                    for k in range(3):
                        p, q, r = start[e, k], end[e, k], radius[e]
                        low[k] = min(low[k], min(p, q) - r)
                        high[k] = max(high[k], max(p, q) + r)
                    radius[e] = INACTIVE
            before = solid
        size = 0.0
        for k in range(3):
            seq.block_start[block, c, k] = 0.5 * (low[k] + high[k])
            seq.block_end[block, c, k] = 0.5 * (low[k] + high[k])
            size += (high[k] - low[k]) ** 2
        seq.block_radius[block, c] = 0.5 * np.sqrt(size)
    for c in range(seq.block_radius.shape[1]):
        r = seq.block_radius[block, c]
        if r < 0.0:
            continue
        for k in range(3):
            p, q = seq.block_start[block, c, k], seq.block_end[block, c, k]
            seq.block_low[block, k] = min(seq.block_low[block, k], min(p, q) - r)
            seq.block_high[block, k] = max(seq.block_high[block, k], max(p, q) + r)


@njit(cache=True)
def place_capsules(
    hulls: HullTable,
    solid: int,
    stretch: Stretch,
    start: Array,
    end: Array,
    radius: Array,
) -> int:
    """Write capsules that hold a body on a stretch; return how many.

    Args:
        hulls: the bodies.
        solid: the body.
        stretch: the stretch, posed and measured.
        start, end: written here, shape (at least its capsules, 3) [m].
        radius: likewise, shape (at least its capsules,) [m].
    """
    first, last = hulls.capsule_first[solid], hulls.capsule_first[solid + 1]
    _sweep_capsules(
        hulls.ends,
        hulls.radius,
        first,
        last,
        hulls.joint[solid],
        stretch.start,
        stretch.middle,
        stretch.end,
        stretch.strays,
        solid,
        start,
        end,
        radius,
        0,
    )
    return int(last - first)


@njit(cache=True)
def _sweep_capsules(
    ends: Array,
    radii: Array,
    first: int,
    last: int,
    joint: int,
    at_start: Array,
    at_middle: Array,
    at_end: Array,
    strays: Array,
    solid: int,
    start: Array,
    end: Array,
    radius: Array,
    column: int,
) -> None:
    """Write capsules of a body on a stretch, from a column on.

    The ends of a capsule stay as near to where they are in the middle as any point does, and
    as near as they are at both ends of the stretch, but for the bend in between.
    """
    p = joint + 1
    for e in range(first, last):
        c = column + e - first
        radius[c] = radii[e]
        if joint == AT_REST:
            for r in range(3):
                start[c, r], end[c, r] = ends[e, 0, r], ends[e, 1, r]
            continue
        off = 0.0
        for k in range(2):
            x, y, z = ends[e, k, 0], ends[e, k, 1], ends[e, k, 2]
            from_start = from_end = 0.0
            for r in range(3):
                m = at_middle[p, r, 0] * x + at_middle[p, r, 1] * y
                m += at_middle[p, r, 2] * z + at_middle[p, r, 3]
                if k == 0:
                    start[c, r] = m
                else:
                    end[c, r] = m
                n = at_start[p, r, 0] * x + at_start[p, r, 1] * y
                n += at_start[p, r, 2] * z + at_start[p, r, 3]
                from_start += (m - n) * (m - n)
                n = at_end[p, r, 0] * x + at_end[p, r, 1] * y
                n += at_end[p, r, 2] * z + at_end[p, r, 3]
                from_end += (m - n) * (m - n)
            off = max(off, from_start, from_end)
        bent = np.sqrt(off) + strays[solid, 1] + strays[solid, 2]
        radius[c] += min(strays[solid, 0], bent)


@njit(cache=True)
def _bound_both(
    start: Array, end: Array, radius: Array, block: int, left: int, right: int
) -> None:
    """Write capsules that hold those of two blocks: those of one of them, grown."""
    for c in range(radius.shape[1]):
        r, s = radius[left, c], radius[right, c]
        chosen, grown = left, r
        if r < 0.0:
            chosen, grown = right, s
        elif s >= 0.0:
            a2 = b2 = 0.0
            for k in range(3):
                da = start[left, c, k] - start[right, c, k]
                db = end[left, c, k] - end[right, c, k]
                a2 += da * da
                b2 += db * db
            apart = np.sqrt(max(a2, b2))
            chosen = left if s <= r else right
            grown = max(max(r, s), apart + min(r, s))
        radius[block, c] = grown
        for k in range(3):
            start[block, c, k] = start[chosen, c, k]
            end[block, c, k] = end[chosen, c, k]
