"""What is occupied, segment after segment, with a binary tree of bounding blocks over it.

A block bounds a run of consecutive segments twice: by one box, and capsule by capsule. Each of
its capsules is that of one segment of the run, grown until it holds those of all the others.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

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
        task, other_task: tasks of each segment, see ``may_touch``, shape (s,).
        start, end: world ends of the capsules, shape (s, c, 3) [m].
        radius: swept radii, shape (s, c) [m]; INACTIVE where there is none.
        body: body of each capsule, shape (c,).
        entity: entity of each body, -1 where there is none, shape (s, bodies).
        still: True where the body does not move whatever the robot does, shape (s, bodies).
        low, high: box around each segment, shape (s, 3) [m].
        block_first, block_last: segments of each block, ``range(first, last)``, shape (b,).
        block_low, block_high: box around each block, shape (b, 3) [m].
        block_start, block_end, block_radius: capsules of each block.
    """

    node: Indices
    task: Indices
    other_task: Indices
    start: Array
    end: Array
    radius: Array
    body: Indices
    entity: npt.NDArray[np.int32]
    still: npt.NDArray[np.bool_]
    low: Array
    high: Array
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
    start: Array,
    end: Array,
    radius: Array,
    body: Indices,
    entity: npt.NDArray[np.int32],
    still: npt.NDArray[np.bool_],
) -> SweptSequence:
    """Build the tree over a sequence of at least one segment; see SweptSequence."""
    count, capsules = radius.shape
    leaves = 1
    while leaves * LEAF < count:
        leaves *= 2
    blocks = 2 * leaves - 1
    low, high = np.empty((count, 3)), np.empty((count, 3))
    out = SweptSequence(
        np.ascontiguousarray(node, dtype=np.int64),
        np.ascontiguousarray(task, dtype=np.int64),
        np.ascontiguousarray(other_task, dtype=np.int64),
        np.ascontiguousarray(start),
        np.ascontiguousarray(end),
        np.ascontiguousarray(radius),
        np.ascontiguousarray(body, dtype=np.int64),
        np.ascontiguousarray(entity, dtype=np.int32),
        np.ascontiguousarray(still, dtype=np.bool_),
        low,
        high,
        np.zeros(blocks, dtype=np.int64),
        np.zeros(blocks, dtype=np.int64),
        np.zeros((blocks, 3)),
        np.zeros((blocks, 3)),
        np.zeros((blocks, capsules, 3)),
        np.zeros((blocks, capsules, 3)),
        np.full((blocks, capsules), INACTIVE),
    )
    _build(out, leaves)
    return out


@njit(cache=True)
def _build(seq: SweptSequence, leaves: int) -> None:
    count, capsules = seq.radius.shape
    for s in range(count):
        for k in range(3):
            seq.low[s, k] = np.inf
            seq.high[s, k] = -np.inf
        for c in range(capsules):
            r = seq.radius[s, c]
            if r < 0.0:
                continue
            for k in range(3):
                a, b = seq.start[s, c, k], seq.end[s, c, k]
                seq.low[s, k] = min(seq.low[s, k], min(a, b) - r)
                seq.high[s, k] = max(seq.high[s, k], max(a, b) + r)
    level = leaves
    size = (count + leaves - 1) // leaves
    while level >= 1:
        for i in range(level):
            block = level - 1 + i
            first, last = min(i * size, count), min((i + 1) * size, count)
            seq.block_first[block], seq.block_last[block] = first, last
            _bound(seq, block, first, last)
        level //= 2
        size *= 2


@njit(cache=True)
def _bound(seq: SweptSequence, block: int, first: int, last: int) -> None:
    for k in range(3):
        seq.block_low[block, k] = np.inf
        seq.block_high[block, k] = -np.inf
    for s in range(first, last):
        for k in range(3):
            seq.block_low[block, k] = min(seq.block_low[block, k], seq.low[s, k])
            seq.block_high[block, k] = max(seq.block_high[block, k], seq.high[s, k])
    for c in range(seq.radius.shape[1]):
        middle = (first + last) // 2
        chosen = -1
        for s in range(first, last):
            if seq.radius[s, c] >= 0.0 and (
                chosen < 0 or abs(s - middle) < abs(chosen - middle)
            ):
                chosen = s
        if chosen < 0:
            continue
        grown = 0.0
        for s in range(first, last):
            r = seq.radius[s, c]
            if r < 0.0:
                continue
            a2 = b2 = 0.0
            for k in range(3):
                da = seq.start[s, c, k] - seq.start[chosen, c, k]
                db = seq.end[s, c, k] - seq.end[chosen, c, k]
                a2 += da * da
                b2 += db * db
            grown = max(grown, np.sqrt(max(a2, b2)) + r)
        seq.block_radius[block, c] = grown
        for k in range(3):
            seq.block_start[block, c, k] = seq.start[chosen, c, k]
            seq.block_end[block, c, k] = seq.end[chosen, c, k]
