"""Dual-tree descent over two swept sequences: proposes conflicts, latest of the other first.

With two robots the conflicts that matter form a staircase: for each node the last node of the
other robot before it that comes too close, unless an earlier node waits for as much already.
Blocks are pruned when their volumes are apart, when nothing in them is at stake (outside the
window from ``floor`` to ``limit``), and, as edges are found, when these imply the rest. Below
the leaves separating planes dismiss pairs of bodies, for ever shorter stretches of both motions.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from planning.geometry.distance import segment_distance
from planning.geometry.exact import TOLERANCE
from planning.geometry.gjk import ROUNDING
from planning.geometry.hull_table import HullTable
from planning.geometry.separation import (
    APART,
    CONFLICT,
    Scratch,
    judge_hulls,
    make_scratch,
    pose_segments,
)
from planning.geometry.stretches import (
    MIXED,
    Stretch,
    make_stretch,
    measure_bodies,
    pose_stretch,
    stretches_stay_apart,
)
from planning.transforms import Array
from scheduling.contacts import ContactTable, may_touch
from scheduling.swept_sequence import LEAF, SweptSequence
from scheduling.temporal_plan_graph import Indices

_BLOCKS = -1
"""Marks a row of the stack as a pair of blocks."""

PROVED = -1
"""In the place of a number of bodies: there is a conflict for certain."""

_LEVELS = 2 * LEAF.bit_length() + 2
"""Lists of bodies that are needed at once: one a halving of two leaves, and two more."""


class Descent(NamedTuple):
    """How far a descent has come, and room to go on.

    Attributes:
        stack: what is still to be looked at: (block, -1, other block, -1, 0, 0), or two
            stretches and a list of bodies, (first, last, first, last, list, its length), shape
            (room, 6).
        pairs: lists of pairs (body of a, body of b), shape (room, 2).
        where: shares of both motions at which proposed pairs come close, NaN where that is
            not known, shape (room, 2).
        a, b: stretches, posed.
        planes: direction in which two bodies were apart last, shape (bodies, bodies, 3).
        scratch: room for the hulls.
    """

    stack: Indices
    pairs: Indices
    where: Array
    a: Stretch
    b: Stretch
    planes: Array
    scratch: Scratch


def start_descent(a: HullTable, b: HullTable) -> Descent:
    """Return a descent that begins at both roots, the first row of the stack."""
    stack = np.zeros((512, 6), dtype=np.int64)
    stack[0, 1] = stack[0, 3] = _BLOCKS
    room = _LEVELS * a.solid.shape[1] * b.solid.shape[1]
    return Descent(
        stack,
        np.empty((room, 2), dtype=np.int64),
        np.full((room, 2), np.nan),
        make_stretch(a),
        make_stretch(b),
        np.zeros((a.solid.shape[1], b.solid.shape[1], 3)),
        make_scratch(a, b),
    )


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


@njit(cache=True, nogil=True)
def keep_close_bodies(
    a: SweptSequence,
    a_hulls: HullTable,
    s: int,
    s_last: int,
    b: SweptSequence,
    b_hulls: HullTable,
    t: int,
    t_last: int,
    table: ContactTable,
    slack: float,
    descent: Descent,
    first: int,
    count: int,
    decide: bool,
) -> int:
    """Copy a list of bodies behind itself but for those that stay apart on two stretches.

    Returns:
        How many are left; with ``decide`` set, PROVED when two segments are proved to conflict.
    """
    pairs, where, scratch = descent.pairs, descent.where, descent.scratch
    single = s_last - s == 1 and t_last - t == 1
    pose_stretch(a_hulls, s, s_last, descent.a)
    pose_stretch(b_hulls, t, t_last, descent.b)
    solid_a, solid_b = descent.a.solid, descent.b.solid
    one_task = (
        a.task[s] == a.task[s_last - 1]
        and a.other_task[s] == a.other_task[s_last - 1]
        and b.task[t] == b.task[t_last - 1]
        and b.other_task[t] == b.other_task[t_last - 1]
    )
    begin = end = first + count
    for e in range(first, begin):
        x, y = pairs[e, 0], pairs[e, 1]
        one, other = solid_a[x], solid_b[y]
        least = np.inf  # not the same all along: look at shorter stretches
        if one != MIXED and other != MIXED:
            if one < 0 or other < 0:
                continue
            if a_hulls.joint[one] < 0 and b_hulls.joint[other] < 0:
                continue
            u, v = a.entity[s, x], b.entity[t, y]
            if u == v:
                continue
            if (
                one_task
                and table.head[u, v] >= 0
                and may_touch(
                    table, u, v, a.task[s], a.other_task[s], b.task[t], b.other_task[t]
                )
            ):
                continue
            robots = u < table.robots and v < table.robots
            least = table.clearance[0] if robots else table.clearance[1]
        pairs[end, 0], pairs[end, 1] = x, y
        where[end, 0] = least
        end += 1
    end = _keep_unseparated(a_hulls, b_hulls, slack - TOLERANCE, descent, begin, end)
    if not single:
        return end - begin
    kept = begin
    if begin < end:
        pose_segments(a_hulls, s, b_hulls, t, scratch)
    for e in range(begin, end):
        x, y, least = pairs[e, 0], pairs[e, 1], where[e, 0]
        scratch.direction[:] = 0.0
        answer = judge_hulls(a_hulls, s, x, b_hulls, t, y, least - slack, scratch)
        if answer == APART:
            continue
        if decide and answer == CONFLICT:
            return PROVED
        pairs[kept, 0], pairs[kept, 1] = x, y
        where[kept] = scratch.where
        kept += 1
    return kept - begin


@njit(cache=True, nogil=True)
def _keep_unseparated(
    a: HullTable,
    b: HullTable,
    slack: float,
    descent: Descent,
    first: int,
    end: int,
) -> int:
    """Drop the pairs of bodies that planes separate on two stretches, posed.

    A plane found for one pair is tried on all others: few pairs need one of their own. More
    than the clearance is asked for, as much as the exact decision tolerates: so what it says
    of two segments does not depend on the stretches they were part of.

    Args:
        a, b: the occupancies.
        slack: taken off the clearances [m].
        descent: with the clearances of the pairs in ``where``, infinite to keep a pair.
        first, end: the list of pairs.

    Returns:
        The new end of the list.
    """
    pairs, where = descent.pairs, descent.where
    on_a, on_b = descent.a, descent.b
    least_a, least_b = on_a.least, on_b.least
    known_a, known_b = on_a.measured, on_b.measured
    at = first
    while at < end:
        x, y, least = pairs[at, 0], pairs[at, 1], where[at, 0] - slack
        at += 1
        if least == np.inf:
            continue
        plane = descent.planes[x, y]
        for attempt in range(2):
            if attempt == 1 and not stretches_stay_apart(
                a, on_a.solid[x], on_a, b, on_b.solid[y], on_b, least, plane
            ):
                break
            on_a.span[3] += 1
            on_b.span[3] += 1
            number_a, number_b = on_a.span[3], on_b.span[3]
            if attempt == 0:
                known_a[x], known_b[y] = -number_a, -number_b
                measure_bodies(a, on_a, plane, 1.0)
                measure_bodies(b, on_b, plane, -1.0)
                if least_a[x] + least_b[y] < max(least, 0.0) + ROUNDING:
                    continue
            for e in range(at, end):
                if where[e, 0] < np.inf:
                    u, v = pairs[e, 0], pairs[e, 1]
                    if known_a[u] != number_a:
                        known_a[u] = -number_a
                    if known_b[v] != number_b:
                        known_b[v] = -number_b
            measure_bodies(a, on_a, plane, 1.0)
            measure_bodies(b, on_b, plane, -1.0)
            at -= 1
            kept = at
            for e in range(at + 1, end):
                u, v, clear = pairs[e, 0], pairs[e, 1], where[e, 0]
                if (
                    clear < np.inf
                    and least_a[u] + least_b[v] >= max(clear - slack, 0.0) + ROUNDING
                ):
                    continue
                pairs[kept, 0], pairs[kept, 1], where[kept, 0] = u, v, clear
                kept += 1
            end = kept
            break
    return end


@njit(cache=True, nogil=True)
def next_proposal(
    a: SweptSequence,
    a_hulls: HullTable,
    b: SweptSequence,
    b_hulls: HullTable,
    table: ContactTable,
    slack: float,
    floor: Indices,
    limit: Indices,
    descent: Descent,
    depth: int,
    decide: bool,
    hits: Indices,
) -> tuple[int, int, int, int, int, int]:
    """Go on with a descent until it has to be decided whether two segments conflict.

    What is proved to conflict is noted in ``hits``; so is whatever capsules alone decide.

    Args:
        a, a_hulls: occupancy of the nodes v that may have to wait.
        b, b_hulls: occupancy of the nodes u that may have to be waited for.
        table: allowed contacts and clearances.
        slack: pairs of bodies whose hulls are proved to keep their clearance less this are
            dropped [m]; NaN to go by the capsules alone, of blocks of one segment each.
        floor: last u that each v waits for already, never falling, by node of ``a``; raised
            as conflicts are noted.
        limit: first u that is not at stake for each v, never falling, by node of ``a``.
        descent: how far it has come.
        depth: filled rows of its stack.
        decide: False to leave every conflict to be decided.
        hits: receives nodes (v, u) in conflict, shape (room, 2), room for one at least.

    Returns:
        The new depth, the two segments, where in ``descent.pairs`` the close pairs of bodies
        begin and how many they are, 0 when there is nothing to decide, and the number of
        hits. The descent is over when the new depth is 0 and nothing is to be decided; it
        stops early when ``hits`` is full.
    """
    found = 0
    gap = wide_gap(table, slack)
    leaf_a, leaf_b = len(a.block_first) // 2, len(b.block_first) // 2
    stack = descent.stack
    while depth > 0:
        depth -= 1
        if stack[depth, 1] == _BLOCKS:
            i, j = stack[depth, 0], stack[depth, 2]
            s, s_last = a.block_first[i], a.block_last[i]
            t, t_last = b.block_first[j], b.block_last[j]
            begin = 0
            leaves = i >= leaf_a and j >= leaf_b
        else:
            i = j = -1
            s, s_last, t, t_last, begin, count = stack[depth]
            leaves = True
        if s >= s_last or t >= t_last:
            continue
        if b.node[t_last - 1] <= floor[a.node[s]]:
            continue
        if b.node[t] >= limit[a.node[s_last - 1]]:
            continue
        if i >= 0:
            if leaves and np.isnan(slack):
                count = touching_bodies(a, i, b, j, table, not decide, descent.pairs)
                if count == 0:
                    continue
                if not decide:
                    descent.where[:count] = np.nan
                    return depth, s, t, 0, count, found
                found = note_hit(a.node[s], b.node[t], floor, hits, found)
                if found == len(hits):
                    return depth, 0, 0, 0, 0, found
                continue
            count = close_blocks(a, i, b, j, gap, leaves, descent.pairs)
            if count == 0:
                continue
        if leaves:
            kept = keep_close_bodies(
                a,
                a_hulls,
                s,
                s_last,
                b,
                b_hulls,
                t,
                t_last,
                table,
                slack,
                descent,
                begin,
                count,
                decide,
            )
            begin += count
            if kept == 0:
                continue
            if kept == PROVED:
                found = note_hit(a.node[s], b.node[t], floor, hits, found)
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
                stack[depth + k, 1] = stack[depth + k, 3] = _BLOCKS
            if j >= leaf_b or (i < leaf_a and s_last - s >= t_last - t):
                stack[depth, 0], stack[depth + 1, 0] = 2 * i + 2, 2 * i + 1
            else:
                stack[depth, 2], stack[depth + 1, 2] = 2 * j + 1, 2 * j + 2
        depth += 2
    return 0, 0, 0, 0, 0, found


@njit(cache=True, nogil=True)
def note_hit(v: int, u: int, floor: Indices, hits: Indices, found: int) -> int:
    """Note that v waits for u; return how many hits there are."""
    hits[found, 0], hits[found, 1] = v, u
    raise_floor(floor, v, u)
    return found + 1


@njit(cache=True, nogil=True)
def raise_floor(floor: Indices, v: int, u: int) -> None:
    """Note that v, and so every later node of its robot, waits for u."""
    while v < len(floor) and floor[v] < u:
        floor[v] = u
        v += 1
