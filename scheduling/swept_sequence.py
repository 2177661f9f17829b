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

from planning.geometry.hull_table import HullTable
from planning.geometry.stretches import (
    MIXED,
    Stretch,
    make_stretch,
    measure_stray,
    pose_stretch,
    sweep_all_capsules,
    sweep_capsules,
)
from planning.transforms import Array
from scheduling.temporal_plan_graph import Indices

LEAF = 4
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


@njit(cache=True, nogil=True)
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
    sweep_all_capsules(hulls, room)
    start, end = seq.block_start[block], seq.block_end[block]
    radius, capsule_first = seq.block_radius[block], hulls.capsule_first
    ends, grown = room.ends, room.radius
    for i in range(len(room.solid)):
        solid, c = room.solid[i], seq.column[i]
        if solid >= 0:
            for e in range(capsule_first[solid], capsule_first[solid + 1]):
                for k in range(3):
                    start[c, k], end[c, k] = ends[e, 0, k], ends[e, 1, k]
                radius[c] = grown[e]
                c += 1
        elif solid == MIXED:
            # Objects that come and go: the first capsule becomes a ball around them all.
            low, high = np.full(3, np.inf), np.full(3, -np.inf)
            for s in range(first, last):
                solid = int(hulls.solid[s, i])
                if solid < 0:
                    continue
                measure_stray(hulls, solid, room)
                sweep_capsules(hulls, solid, room)
                for e in range(capsule_first[solid], capsule_first[solid + 1]):
                    for k in range(3):
                        p, q, r = ends[e, 0, k], ends[e, 1, k], grown[e]
                        low[k] = min(low[k], min(p, q) - r)
                        high[k] = max(high[k], max(p, q) + r)
            start[c], end[c] = 0.5 * (low + high), 0.5 * (low + high)
            radius[c] = 0.5 * np.sqrt(np.sum((high - low) ** 2))
    for c in range(len(radius)):
        r = radius[c]
        if r < 0.0:
            continue
        for k in range(3):
            p, q = start[c, k], end[c, k]
            seq.block_low[block, k] = min(seq.block_low[block, k], min(p, q) - r)
            seq.block_high[block, k] = max(seq.block_high[block, k], max(p, q) + r)


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
