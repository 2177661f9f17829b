"""Dual-tree descent over two swept sequences: proposes conflicts, latest of the other first.

With two robots the conflicts that matter form a staircase: for each node the last node of the
other robot before it that comes too close, unless an earlier node waits for as much already.
Blocks are pruned when their volumes are apart, when nothing in them is at stake (outside the
window from ``floor`` to ``limit``), and, as edges are found, when these imply the rest. Below
the leaves separating planes dismiss pairs of bodies, for ever shorter stretches of both motions.
"""

from __future__ import annotations

from planning.kernels import ZERO, kernel
from planning.transforms import Indices
from scheduling.conflicts.block_pairs import close_blocks
from scheduling.conflicts.close_bodies import BLOCKS, PROVED, Descent, keep_close_bodies


@kernel
def next_proposal(
    descent: Descent, depth: int, hits: Indices
) -> tuple[int, int, int, int, int, int]:
    """Go on with a descent until it has to be decided whether two segments conflict.

    What is proved to conflict is noted in ``hits``.

    Args:
        descent: how far it has come.
        depth: filled rows of its stack.
        hits: receives nodes (v, u) in conflict, shape (room, 2), room for one at least.

    Returns:
        The new depth, the two segments, where in ``descent.pairs`` the close pairs of bodies
        begin and how many they are, 0 when there is nothing to decide, and the number of
        hits. The descent is over when the new depth is 0 and nothing is to be decided; it
        stops early when ``hits`` is full.
    """
    a, b, floor, limit = descent.a, descent.b, descent.floor, descent.limit
    found = ZERO
    leaf_a, leaf_b = len(a.block_first) // 2, len(b.block_first) // 2
    stack = descent.stack
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
            count = close_blocks(a, i, b, j, descent.gap, leaves, descent.pairs)
            if count == 0:
                continue
        if leaves:
            kept = keep_close_bodies(descent, s, s_last, t, t_last, begin, count)
            begin += count
            if kept == 0:
                continue
            if kept == PROVED:
                hits[found, 0], hits[found, 1] = a.node[s], b.node[t]
                raise_floor(floor, a.node[s], b.node[t])
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
def raise_floor(floor: Indices, v: int, u: int) -> None:
    """Note that v, and so every later node of its robot, waits for u."""
    while v < len(floor) and floor[v] < u:
        floor[v] = u
        v += 1
