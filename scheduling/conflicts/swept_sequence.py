"""Sequence of swept segments with a binary tree of bounding volumes.

A block of the tree contains consecutive segments. It stores one bounding box, and a bounding capsule for each
capsule of the robot. The capsules of a leaf block are placed at the middle of its joint ranges, and enlarged by
an upper bound on the displacement from there. A larger block takes the capsules of its first or second half,
enlarged until they contain the capsules of the other half. Single segments store no capsules, because tests of
their convex hulls are tighter.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from planning.geometry.hull_table import HullTable
from planning.geometry.stretches import (
    MIXED,
    PosedStretch,
    make_stretch,
    measure_deviation,
    pose_stretch,
    sweep_all_capsules,
    sweep_capsules,
)
from planning.kernels import ZERO, inner_kernel, kernel
from planning.packed import packed
from planning.transforms import Array, Indices

LEAF = 4
"""Maximum number of segments in a leaf."""

INACTIVE = -1.0
"""Radius that marks an unused capsule."""

_ROUNDING = 3e-7
"""Upper bound on the relative rounding error of positions and radii in single precision."""


class SweptSequence(NamedTuple):
    """Segments in order, and blocks of them; block b has the children 2b + 1 and 2b + 2.

    The leaves are the second half of the blocks.

    Attributes:
        hulls: the bodies in motion.
        node: node of each segment, non-decreasing, shape (s,).
        task, other_task: tasks of each segment, see ``is_contact_allowed``, non-decreasing, shape (s,).
        entity: entity of each body, -1 where there is none, shape (s, bodies).
        column: where the capsules of each body begin, shape (bodies + 1,).
        block_first, block_last: segments of each block, ``range(first, last)``, shape (b,).
        block_box: least and greatest corner of each block, shape (b, 6) [m].
        capsules: of the blocks: both ends in the world and the radius, INACTIVE where there is
            none, shape (b, c, 7) [m]. In single precision to save memory, and enlarged by its
            rounding error.
    """

    hulls: HullTable
    node: Indices
    task: Indices
    other_task: Indices
    entity: npt.NDArray[np.int32]
    column: Indices
    block_first: Indices
    block_last: Indices
    block_box: Array
    capsules: npt.NDArray[np.float32]


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
        leaf: maximum number of segments in a leaf, up to LEAF; 1 for unrelated segments.
    """
    leaves = -(-len(node) // leaf)
    blocks = 2 * leaves - 1
    widths = np.append(np.diff(hulls.capsule_first), 0)  # the last one means none
    column = np.cumsum([0, *np.max(widths[hulls.solid], axis=0)]).astype(np.int64)
    out = packed(
        SweptSequence(
            hulls,
            np.ascontiguousarray(node, dtype=np.int64),
            np.ascontiguousarray(task, dtype=np.int64),
            np.ascontiguousarray(other_task, dtype=np.int64),
            np.ascontiguousarray(entity, dtype=np.int32),
            column,
            np.zeros(blocks, dtype=np.int64),
            np.zeros(blocks, dtype=np.int64),
            np.empty((blocks, 6)),
            # Left uninitialized: writing so much memory twice would cost time.
            np.empty((blocks, int(column[-1]), 7), dtype=np.float32),
        )
    )
    _build(out, leaves, make_stretch(hulls))
    return out


@kernel
def _build(seq: SweptSequence, leaves: int, room: PosedStretch) -> None:
    # Leaves on the deepest level come first in the sequence, though last among the blocks.
    box, count = seq.block_box, len(seq.node)
    deepest = 1
    while deepest < leaves:
        deepest *= 2
    deepest -= 1
    for i in range(leaves):
        block = deepest + i
        if block > 2 * leaves - 2:
            block -= leaves
        seq.block_first[block] = i * count // leaves
        seq.block_last[block] = (i + 1) * count // leaves
        bound_leaf(seq, block, room)
    for block in range(leaves - 2, -1, -1):
        left, right = 2 * block + 1, 2 * block + 2
        seq.block_first[block] = seq.block_first[left]
        seq.block_last[block] = seq.block_last[right]
        for k in range(3):
            box[block, k] = min(box[left, k], box[right, k])
            box[block, k + 3] = max(box[left, k + 3], box[right, k + 3])
        _bound_both(seq.capsules, block, left, right)


@inner_kernel
def bound_leaf(seq: SweptSequence, block: int, room: PosedStretch) -> None:
    """Write the capsules and the box of a block from its segments."""
    hulls, box = seq.hulls, seq.block_box[block]
    first, last = seq.block_first[block], seq.block_last[block]
    pose_stretch(hulls, first, last, room)
    sweep_all_capsules(hulls, room)
    out, capsule_first = seq.capsules[block], hulls.capsule_first
    for c in range(len(out)):
        out[c, 6] = INACTIVE
    for k in range(3):
        box[k], box[k + 3] = np.inf, -np.inf
    ends, grown, ball = room.ends, room.radius, np.empty(6)
    for i in range(len(room.solid)):
        solid, c = room.solid[i], seq.column[i]
        if solid >= 0:
            for e in range(capsule_first[solid], capsule_first[solid + 1]):
                _write_capsule(out, c, ends[e, 0], ends[e, 1], grown[e])
                c += 1
        elif solid == MIXED:
            # Objects that come and go: the first capsule becomes a ball around them all.
            for k in range(3):
                ball[k], ball[k + 3] = np.inf, -np.inf
            for s in range(first, last):
                solid = ZERO + hulls.solid[s, i]
                if solid < 0:
                    continue
                measure_deviation(hulls, solid, room)
                sweep_capsules(hulls, solid, room)
                for e in range(capsule_first[solid], capsule_first[solid + 1]):
                    for k in range(3):
                        p, q, r = ends[e, 0, k], ends[e, 1, k], grown[e]
                        ball[k] = min(ball[k], min(p, q) - r)
                        ball[k + 3] = max(ball[k + 3], max(p, q) + r)
            wide = 0.0
            for k in range(3):
                wide += (ball[k + 3] - ball[k]) ** 2
                ball[k] = 0.5 * (ball[k] + ball[k + 3])
            _write_capsule(out, c, ball[:3], ball[:3], 0.5 * np.sqrt(wide))
    for c in range(len(out)):
        r = float(out[c, 6])
        if r < 0.0:
            continue
        for k in range(3):
            p, q = float(out[c, k]), float(out[c, k + 3])
            box[k] = min(box[k], min(p, q) - r)
            box[k + 3] = max(box[k + 3], max(p, q) + r)


@inner_kernel
def _write_capsule(
    out: npt.NDArray[np.float32], c: int, start: Array, end: Array, radius: float
) -> None:
    """Write a capsule in single precision, enlarged so that it contains the given one."""
    far = radius
    for k in range(3):
        out[c, k], out[c, k + 3] = start[k], end[k]
        far = max(far, max(abs(start[k]), abs(end[k])))
    out[c, 6] = radius + _ROUNDING * far


@inner_kernel
def _bound_both(
    capsules: npt.NDArray[np.float32], block: int, left: int, right: int
) -> None:
    """Write capsules that contain those of two blocks, by enlarging the capsules of one of them."""
    one, two, out = capsules[left], capsules[right], capsules[block]
    for c in range(len(out)):
        r, s = float(one[c, 6]), float(two[c, 6])
        chosen, grown = one, r
        if r < 0.0:
            chosen, grown = two, s
        elif s >= 0.0:
            a2 = b2 = 0.0
            for k in range(3):
                da = float(one[c, k]) - float(two[c, k])
                db = float(one[c, k + 3]) - float(two[c, k + 3])
                a2 += da * da
                b2 += db * db
            apart = np.sqrt(max(a2, b2))
            chosen = one if s <= r else two
            grown = max(max(r, s), apart + min(r, s)) * (1.0 + _ROUNDING)
        for k in range(6):
            out[c, k] = chosen[c, k]
        out[c, 6] = grown
