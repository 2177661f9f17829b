"""Search for the conflicts between two occupancies, with one bounding-volume tree for each of them.

An occupancy is the swept volume of consecutive motion segments of a robot. Both trees are descended together. A
pair of subtrees is skipped when their volumes are apart, when it is outside the requested range of nodes, or when
edges found so far already order all its conflicts. Only necessary edges are returned: for each node, the last
node of the other robot that it must wait for. At the leaves, separating planes exclude pairs of bodies over
successively shorter parts of the motion. Single segments conflict if their convex hulls are too close.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from planning.geometry.distance import are_boxes_apart, segment_distance
from planning.geometry.exact import hull_distance_at, may_come_close
from planning.kernels import ZERO, inner_kernel, kernel
from planning.transforms import Indices
from scheduling.conflicts.allowed_contacts import ContactTable
from scheduling.conflicts.close_bodies import (
    BLOCKS,
    PROVED,
    Descent,
    keep_close_bodies,
    start_descent,
)
from scheduling.conflicts.occupancy import Occupancy
from scheduling.conflicts.swept_sequence import SweptSequence

_MOST_HITS = 32768
"""Most conflicts that are found before they are passed on."""


def hulls_conflict(
    a: Occupancy, s: int, b: Occupancy, t: int, descent: Descent, proposed: slice
) -> bool:
    """Decide by convex hull distances over both whole motions whether segments conflict.

    Args:
        a, s: an occupancy and a segment of it.
        b, t: another robot's occupancy and a segment of it.
        descent: the descent that found the pairs of bodies.
        proposed: the pairs of bodies, as a slice of its lists.
    """
    table, robots = descent.table, descent.table.robots
    a_from, a_to = a.hulls.q_a[s], a.hulls.q_b[s]
    b_from, b_to = b.hulls.q_a[t], b.hulls.q_b[t]
    pairs, where = (
        descent.room.pairs[proposed].tolist(),
        descent.room.where[proposed].tolist(),
    )
    for (i, j), (x, y) in zip(pairs, where, strict=True):
        one, other = a.sequence.entity[s, i], b.sequence.entity[t, j]
        solid_a = a.solids[a.hulls.solid[s, i]]
        solid_b = b.solids[b.hulls.solid[t, j]]
        # As in ``least_distance``, which only compiled code can call.
        both = (one < robots or solid_a.joint >= 0) and (
            other < robots or solid_b.joint >= 0
        )
        limit = float(table.clearance[0 if both else 1]) - descent.slack
        q_a, q_b = a_from + x * (a_to - a_from), b_from + y * (b_to - b_from)
        if hull_distance_at(solid_a, q_a, solid_b, q_b) < limit:
            return True
        if may_come_close(solid_a, a_from, a_to, solid_b, b_from, b_to, limit):
            return True
    return False


def search_conflicts(
    a: Occupancy,
    b: Occupancy,
    floor: Indices,
    limit: Indices,
    table: ContactTable,
    slack: float = 0.0,
) -> Iterator[tuple[int, int]]:
    """Yield conflicts (v, u) of two occupancies until those yielded imply all others.

    (v, u) implies (w, x) when w is not before v and x is not after u.

    Args:
        a: occupancy of the nodes v.
        b: occupancy of the nodes u.
        floor: last u implied for each v so far, non-decreasing; raised here.
        limit: first u outside the query, for each v, non-decreasing.
        table: allowed contacts and clearances.
        slack: subtracted from the clearances [m].
    """
    if are_apart_everywhere(a.sequence, b.sequence, table.gap):
        return
    depth = 1
    # Begin with room for one: a caller may need the first conflict only.
    hits = np.empty((1, 2), dtype=np.int64)
    sequences = a.sequence, b.sequence
    with start_descent(*sequences, table, floor, limit, slack) as descent:
        while depth > 0:
            depth, s, t, first, bodies, found = next_proposal(descent, depth, hits)
            yield from map(tuple, hits[:found].tolist())
            if found == len(hits):
                hits = np.empty((min(8 * found, _MOST_HITS), 2), dtype=np.int64)
            if bodies == 0:
                continue
            if hulls_conflict(a, s, b, t, descent, slice(first, first + bodies)):
                v, u = int(a.sequence.node[s]), int(b.sequence.node[t])
                raise_wait_floor(floor, v, u)
                yield v, u


def first_conflict(
    a: Occupancy,
    b: Occupancy,
    floor: Indices,
    limit: Indices,
    table: ContactTable,
    slack: float = 0.0,
) -> tuple[int, int] | None:
    """Return a conflict of two occupancies, None if there is none; see ``search_conflicts``.

    Neither ``floor`` nor ``limit`` is changed.
    """
    floor, limit = np.array(floor, np.int64), np.array(limit, np.int64)
    return next(search_conflicts(a, b, floor, limit, table, slack), None)


@kernel
def next_proposal(
    descent: Descent, depth: int, hits: Indices
) -> tuple[int, int, int, int, int, int]:
    """Continue a descent up to the next pair of segments that needs an exact decision.

    Conflicts that are proved on the way are written into ``hits``.

    Args:
        descent: state of the descent.
        depth: number of filled rows of its stack.
        hits: receives nodes (v, u) in conflict, shape (room, 2), with at least one row.

    Returns:
        The new depth, the two segments, the first row of ``descent.room.pairs`` with the close
        pairs of bodies, the number of these rows (0 when there is nothing to decide), and the
        number of hits. The descent is over when the new depth is 0 and there is nothing to
        decide; it stops early when ``hits`` is full.
    """
    a, b, floor, limit = descent.a, descent.b, descent.floor, descent.limit
    found = ZERO
    leaf_a, leaf_b = len(a.block_first) // 2, len(b.block_first) // 2
    stack, pairs, gap = descent.room.stack, descent.room.pairs, descent.table.gap
    while depth > 0:
        depth -= 1
        row = stack[depth]
        if row[1] == BLOCKS:
            i, j = row[0], row[2]
            s, s_last = a.block_first[i], a.block_last[i]
            t, t_last = b.block_first[j], b.block_last[j]
            begin = ZERO
            leaves = i >= leaf_a and j >= leaf_b
        else:
            i = j = ZERO - 1
            s, s_last, t, t_last = row[0], row[1], row[2], row[3]
            begin, count = row[4], row[5]
            leaves = True
        if s >= s_last or t >= t_last:
            continue
        if b.node[t_last - 1] <= floor[a.node[s]]:
            continue
        if b.node[t] >= limit[a.node[s_last - 1]]:
            continue
        if i >= 0:
            count = close_blocks(a, i, b, j, gap, leaves, pairs)
            if count == 0:
                continue
        if leaves:
            kept = keep_close_bodies(descent, s, s_last, t, t_last, begin, count)
            begin += count
            if kept == 0:
                continue
            if kept == PROVED:
                hits[found, 0], hits[found, 1] = a.node[s], b.node[t]
                raise_wait_floor(floor, a.node[s], b.node[t])
                found += 1
                if found == len(hits):
                    return depth, 0, 0, 0, 0, found
                continue
            if s_last - s == 1 and t_last - t == 1:
                return depth, s, t, begin, kept, found
            # The top of the stack comes next: earliest v first, latest u first.
            for k in range(2):
                row = stack[depth + k]
                row[0], row[1], row[2], row[3] = s, s_last, t, t_last
                row[4], row[5] = begin, kept
            if s_last - s >= t_last - t:
                stack[depth, 0] = stack[depth + 1, 1] = (s + s_last) // 2
            else:
                stack[depth, 3] = stack[depth + 1, 2] = (t + t_last) // 2
        else:
            for k in range(2):
                stack[depth + k, 0], stack[depth + k, 2] = i, j
                stack[depth + k, 1] = stack[depth + k, 3] = BLOCKS
            if j >= leaf_b or (i < leaf_a and s_last - s >= t_last - t):
                stack[depth, 0], stack[depth + 1, 0] = 2 * i + 2, 2 * i + 1
            else:
                stack[depth, 2], stack[depth + 1, 2] = 2 * j + 1, 2 * j + 2
        depth += 2
    return 0, 0, 0, 0, 0, found


@kernel
def are_apart_everywhere(a: SweptSequence, b: SweptSequence, gap: float) -> bool:
    """Tell whether the bounding volumes of two whole occupancies are apart."""
    pairs = np.empty((1, 2), dtype=np.int64)
    return close_blocks(a, ZERO, b, ZERO, gap, ZERO > 0, pairs) == 0


@kernel
def raise_wait_floor(floor: Indices, v: int, u: int) -> None:
    """Record that v, and so every later node of its robot, waits for u."""
    while v < len(floor) and floor[v] < u:
        floor[v] = u
        v += 1


@inner_kernel
def close_blocks(
    a: SweptSequence,
    i: int,
    b: SweptSequence,
    j: int,
    gap: float,
    every: bool,
    out: Indices,
) -> int:
    """Write the pairs of bodies of two blocks whose capsules are too close, into ``out``.

    Returns:
        Their number; with ``every`` unset, 1 as soon as there is one.
    """
    if are_boxes_apart(a.block_box, i, b.block_box, j, gap):
        return 0
    count = 0
    theirs, box = b.capsules[j], b.block_box[j]
    for x in range(len(a.column) - 1):
        begin = count
        for c in range(a.column[x], a.column[x + 1]):
            mine = a.capsules[i, c]
            r = float(mine[6]) + gap
            if mine[6] < 0.0:
                continue
            p0, p1, p2 = float(mine[0]), float(mine[1]), float(mine[2])
            q0, q1, q2 = float(mine[3]), float(mine[4]), float(mine[5])
            x0, x1, x2 = min(p0, q0) - r, min(p1, q1) - r, min(p2, q2) - r
            y0, y1, y2 = max(p0, q0) + r, max(p1, q1) + r, max(p2, q2) + r
            if x0 > box[3] or x1 > box[4] or x2 > box[5]:
                continue
            if y0 < box[0] or y1 < box[1] or y2 < box[2]:
                continue
            for y in range(len(b.column) - 1):
                seen = False
                for e in range(begin, count):
                    if out[e, 1] == y:
                        seen = True
                        break
                if seen:
                    continue
                for d in range(b.column[y], b.column[y + 1]):
                    s = float(theirs[d, 6])
                    if s < 0.0:
                        continue
                    u0, v0 = float(theirs[d, 0]), float(theirs[d, 3])
                    if min(u0, v0) - s > y0 or max(u0, v0) + s < x0:
                        continue
                    u1, v1 = float(theirs[d, 1]), float(theirs[d, 4])
                    if min(u1, v1) - s > y1 or max(u1, v1) + s < x1:
                        continue
                    u2, v2 = float(theirs[d, 2]), float(theirs[d, 5])
                    if min(u2, v2) - s > y2 or max(u2, v2) + s < x2:
                        continue
                    apart = segment_distance(
                        (q0 - p0, q1 - p1, q2 - p2),
                        (v0 - u0, v1 - u1, v2 - u2),
                        (p0 - u0, p1 - u1, p2 - u2),
                    )
                    if apart < (r + s) * (r + s):
                        out[count, 0], out[count, 1] = x, y
                        count += 1
                        if not every:
                            return count
                        break
    return count
