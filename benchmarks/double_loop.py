"""Algorithm 1 of APEX-MR as a compiled double loop, to compare the dual-tree search with.

The same bodies, capsules, separating planes and exact decision as the product; only the tree is
missing. Each node is held against all earlier nodes of the other robot, latest first, one pair
of segments at a time, but for those that precede it already: by task dependencies, or also by
the edges found so far (``growing``), which is the strictest reading of the algorithm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from planning.geometry.stretches import Stretch, make_stretch
from planning.kernels import kernel
from planning.packed import packed
from planning.transforms import Indices
from scheduling.conflicts.allowed_contacts import ContactTable
from scheduling.conflicts.close_bodies import (
    PROVED,
    Descent,
    keep_close_bodies,
    start_descent,
)
from scheduling.conflicts.conflict_search import (
    close_blocks,
    hulls_conflict,
    raise_floor,
)
from scheduling.conflicts.occupancy import Occupancy
from scheduling.conflicts.swept_sequence import (
    SweptSequence,
    bound_leaf,
)
from scheduling.graph.reduction import NodeOrder
from scheduling.graph.total_order import nodes_before


def segment_capsules(occupancy: Occupancy) -> Occupancy:
    """Return an occupancy with every segment a block of its own, without a tree."""
    tree = occupancy.sequence
    count, capsules = len(tree.node), tree.capsules.shape[1]
    first = np.arange(count)
    flat = packed(
        tree._replace(
            block_first=first,
            block_last=first + 1,
            block_box=np.empty((count, 6)),
            capsules=np.empty((count, capsules, 7), dtype=np.float32),
        )
    )
    _bound_segments(flat, make_stretch(flat.hulls))
    return replace(occupancy, sequence=flat)


@kernel
def _bound_segments(seq: SweptSequence, room: Stretch) -> None:
    for s in range(len(seq.node)):
        bound_leaf(seq, s, room)


@kernel
def _scan(
    descent: Descent, stop: Indices, growing: bool, at: Indices, hits: Indices
) -> tuple[int, int, int]:
    """Go on until hulls have to be decided on, or ``hits`` is full.

    Args:
        descent: what is compared, every segment a block of its own.
        stop: one above the last segment of b at stake for each segment of a.
        growing: whether what the edges found so far imply is skipped.
        at: segment of a, the segment of b looked at last, and how many pairs were tested.
        hits: receives nodes (v, u) that are proved to conflict, shape (room, 2).

    Returns:
        Where in ``descent.pairs`` the bodies begin that have to be decided on, how many they
        are, and the number of hits; all are 0 at the end.
    """
    a, b, floor = descent.a, descent.b, descent.floor
    s, t = at[0], at[1]
    found = 0
    while s < len(a.node):
        v = a.node[s]
        while t > 0 and b.node[t - 1] > floor[v]:
            t -= 1
            at[2] += 1
            count = close_blocks(a, s, b, t, descent.gap, True, descent.pairs)
            if count == 0:
                continue
            kept = keep_close_bodies(descent, s, s + 1, t, t + 1, 0, count)
            if kept == 0:
                continue
            if kept != PROVED:
                at[0], at[1] = s, t
                return count, kept, found
            hits[found, 0], hits[found, 1] = v, b.node[t]
            found += 1
            if growing:
                raise_floor(floor, v, b.node[t])
            else:
                t = _before_node(b, t)
            if found == len(hits):
                at[0], at[1] = s, t
                return 0, 0, found
        s += 1
        if s < len(a.node):
            t = stop[s]
    at[0], at[1] = s, 0
    return 0, 0, found


@kernel
def _before_node(b: SweptSequence, t: int) -> int:
    """Return the first segment of the node that a segment belongs to."""
    while t > 0 and b.node[t - 1] == b.node[t]:
        t -= 1
    return t


def search_double_loop(
    a: Occupancy,
    b: Occupancy,
    floor: Indices,
    limit: Indices,
    table: ContactTable,
    growing: bool,
) -> tuple[Indices, int]:
    """Return conflicting nodes (v, u), shape (found, 2), and how many pairs were tested.

    Every segment of ``a`` and ``b`` is a block of its own; see ``segment_capsules``.
    """
    room = start_descent(a.sequence, b.sequence, table, floor, limit, 0.0)
    stop = np.searchsorted(b.sequence.node, limit[a.sequence.node], side="left")
    at = np.array([0, stop[0], 0], dtype=np.int64)
    hits = np.empty((65536, 2), dtype=np.int64)
    out = [np.empty((0, 2), dtype=np.int64)]
    while True:
        first, count, found = _scan(room, stop, growing, at, hits)
        out.append(hits[:found].copy())
        if count == 0:
            if found == 0:
                return np.concatenate(out), int(at[2])
            continue
        s, t = int(at[0]), int(at[1])
        if hulls_conflict(a, s, b, t, room, slice(first, first + count)):
            v, u = int(a.sequence.node[s]), int(b.sequence.node[t])
            out.append(np.array([[v, u]]))
            if growing:
                raise_floor(floor, v, u)
            else:
                at[1] = _before_node(b.sequence, t)


def find_edges_double_loop(
    flat: Sequence[Occupancy],
    ranks: Sequence[Indices],
    order: NodeOrder,
    table: ContactTable,
    growing: bool,
) -> tuple[Indices, int]:
    """Return what ``find_motion_edges`` returns, by the double loop, and the pairs tested."""
    tests = 0
    edges = [np.empty((0, 4), dtype=np.int64)]
    robots = range(len(flat))
    for i, k in ((i, k) for i in robots for k in robots if i != k):
        pairs, tested = search_double_loop(
            flat[i],
            flat[k],
            np.ascontiguousarray(order.last_before(i, k)),
            nodes_before(ranks, i, k),
            table,
            growing,
        )
        tests += tested
        v, u = pairs.T
        edges.append(np.column_stack([np.full(len(v), k), u, np.full(len(v), i), v]))
    return np.unique(np.concatenate(edges), axis=0), tests
