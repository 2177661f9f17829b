"""Bodies of two blocks of swept sequences whose capsules come too close, compiled."""

from __future__ import annotations

import numpy as np
from numba import njit

from planning.geometry.distance import segment_distance
from planning.geometry.exact import TOLERANCE
from planning.transforms import Array, Indices
from scheduling.conflicts.allowed_contacts import ContactTable, may_touch
from scheduling.conflicts.swept_sequence import SweptSequence


@njit(cache=True, nogil=True)
def wide_gap(table: ContactTable, slack: float) -> float:
    """Return how far apart capsules must be to dismiss what they hold [m].

    Hulls are decided on with a tolerance.
    """
    gap = max(table.clearance[0], table.clearance[1])
    return float(gap + (0.0 if np.isnan(slack) else TOLERANCE))


@njit(cache=True, nogil=True)
def _boxes_apart(
    a_low: Array, a_high: Array, b_low: Array, b_high: Array, gap: float
) -> bool:
    for k in range(3):
        if a_low[k] - b_high[k] > gap or b_low[k] - a_high[k] > gap:
            return True
    return False


@njit(cache=True, nogil=True)
def close_blocks(
    a: SweptSequence,
    i: int,
    b: SweptSequence,
    j: int,
    gap: float,
    every: bool,
    out: Indices,
) -> int:
    """Write the pairs of bodies of two blocks whose capsules come too close.

    Returns:
        Their number; with ``every`` unset, 1 as soon as there is one.
    """
    if _boxes_apart(
        a.block_low[i], a.block_high[i], b.block_low[j], b.block_high[j], gap
    ):
        return 0
    count = 0
    theirs = b.capsules[j]
    low, high = b.block_low[j], b.block_high[j]
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
            if x0 > high[0] or x1 > high[1] or x2 > high[2]:
                continue
            if y0 < low[0] or y1 < low[1] or y2 < low[2]:
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
                        q0 - p0,
                        q1 - p1,
                        q2 - p2,
                        v0 - u0,
                        v1 - u1,
                        v2 - u2,
                        p0 - u0,
                        p1 - u1,
                        p2 - u2,
                    )
                    if apart < (r + s) * (r + s):
                        out[count, 0], out[count, 1] = x, y
                        count += 1
                        if not every:
                            return count
                        break
    return count


@njit(cache=True, nogil=True)
def touching_bodies(
    a: SweptSequence,
    i: int,
    b: SweptSequence,
    j: int,
    table: ContactTable,
    every: bool,
    out: Indices,
) -> int:
    """Write the pairs of bodies of two blocks of one segment whose capsules are too close.

    Unlike ``close_blocks`` it asks no pair for more than its own clearance, and none that may
    touch for any.

    Returns:
        Their number; with ``every`` unset, 1 as soon as there is one.
    """
    count = close_blocks(a, i, b, j, wide_gap(table, np.nan), True, out)
    s, t = a.block_first[i], b.block_first[j]
    kept = 0
    for e in range(count):
        x, y = out[e, 0], out[e, 1]
        u, v = a.entity[s, x], b.entity[t, y]
        if u == v or (a.still[s, x] and b.still[t, y]):
            continue
        if table.head[u, v] >= 0 and may_touch(
            table, u, v, a.task[s], a.other_task[s], b.task[t], b.other_task[t]
        ):
            continue
        robots = u < table.robots and v < table.robots
        least = table.clearance[0] if robots else table.clearance[1]
        if _capsules_near(a, i, x, b, j, y, least):
            out[kept, 0], out[kept, 1] = x, y
            kept += 1
            if not every:
                break
    return kept


@njit(cache=True, nogil=True)
def _capsules_near(
    a: SweptSequence, i: int, x: int, b: SweptSequence, j: int, y: int, gap: float
) -> bool:
    """Tell whether capsules of two bodies of two blocks come closer than a gap."""
    for c in range(a.column[x], a.column[x + 1]):
        mine = a.capsules[i, c]
        r = float(mine[6])
        if r < 0.0:
            continue
        p0, p1, p2 = float(mine[0]), float(mine[1]), float(mine[2])
        u0, u1, u2 = float(mine[3]) - p0, float(mine[4]) - p1, float(mine[5]) - p2
        for d in range(b.column[y], b.column[y + 1]):
            theirs = b.capsules[j, d]
            q = float(theirs[6])
            if q < 0.0:
                continue
            q0, q1, q2 = float(theirs[0]), float(theirs[1]), float(theirs[2])
            apart = segment_distance(
                u0,
                u1,
                u2,
                float(theirs[3]) - q0,
                float(theirs[4]) - q1,
                float(theirs[5]) - q2,
                p0 - q0,
                p1 - q1,
                p2 - q2,
            )
            near = r + q + gap
            if apart < near * near:
                return True
    return False
