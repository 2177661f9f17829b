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
    Scratch,
    hulls_stay_apart,
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
    sweep_all_capsules,
)
from planning.transforms import Array
from scheduling.contacts import ContactTable, may_touch
from scheduling.occupancy import MOTION
from scheduling.swept_sequence import LEAF, SweptSequence
from scheduling.temporal_plan_graph import Indices

_BLOCKS = -1
"""Marks a row of the stack as a pair of blocks."""

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


@njit(cache=True)
def wide_gap(table: ContactTable, slack: float) -> float:
    """Return how far apart capsules must be to dismiss what they hold [m].

    Hulls are decided on with a tolerance. Where the capsules of segments decide, those of
    blocks must leave room for them: they stand out of what they hold, by half of what a
    segment moves at most.
    """
    gap = max(table.clearance[0], table.clearance[1])
    return float(gap + (MOTION if np.isnan(slack) else TOLERANCE))


@njit(cache=True)
def _boxes_apart(
    a_low: Array, a_high: Array, b_low: Array, b_high: Array, gap: float
) -> bool:
    for k in range(3):
        if a_low[k] - b_high[k] > gap or b_low[k] - a_high[k] > gap:
            return True
    return False


@njit(cache=True)
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
    start, end, radius = b.block_start[j], b.block_end[j], b.block_radius[j]
    low, high = b.block_low[j], b.block_high[j]
    for x in range(len(a.column) - 1):
        begin = count
        for c in range(a.column[x], a.column[x + 1]):
            r = a.block_radius[i, c] + gap
            if a.block_radius[i, c] < 0.0:
                continue
            p0, p1, p2 = (
                a.block_start[i, c, 0],
                a.block_start[i, c, 1],
                a.block_start[i, c, 2],
            )
            q0, q1, q2 = (
                a.block_end[i, c, 0],
                a.block_end[i, c, 1],
                a.block_end[i, c, 2],
            )
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
                    s = radius[d]
                    if s < 0.0:
                        continue
                    u0, v0 = start[d, 0], end[d, 0]
                    if min(u0, v0) - s > y0 or max(u0, v0) + s < x0:
                        continue
                    u1, v1 = start[d, 1], end[d, 1]
                    if min(u1, v1) - s > y1 or max(u1, v1) + s < x1:
                        continue
                    u2, v2 = start[d, 2], end[d, 2]
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


@njit(cache=True)
def _any_capsules_near(
    a: HullTable, b: HullTable, extra: float, descent: Descent, begin: int, end: int
) -> bool:
    """Tell whether capsules of any pair listed come too close on the stretches posed.

    Args:
        a, b: the occupancies.
        extra: added to the clearances, which are in ``descent.where`` [m].
        descent: with the stretches, posed, and the list of pairs.
        begin, end: the list.
    """
    sweep_all_capsules(a, descent.a)
    sweep_all_capsules(b, descent.b)
    ends_a, grown_a, first_a = descent.a.ends, descent.a.radius, a.capsule_first
    ends_b, grown_b, first_b = descent.b.ends, descent.b.radius, b.capsule_first
    solid_a, solid_b = descent.a.solid, descent.b.solid
    pairs, where = descent.pairs, descent.where
    for e in range(begin, end):
        gap = where[e, 0] + extra
        if gap == np.inf:
            return True
        x, y = solid_a[pairs[e, 0]], solid_b[pairs[e, 1]]
        for c in range(first_a[x], first_a[x + 1]):
            p0, p1, p2 = ends_a[c, 0, 0], ends_a[c, 0, 1], ends_a[c, 0, 2]
            u0, u1, u2 = (
                ends_a[c, 1, 0] - p0,
                ends_a[c, 1, 1] - p1,
                ends_a[c, 1, 2] - p2,
            )
            for d in range(first_b[y], first_b[y + 1]):
                q0, q1, q2 = ends_b[d, 0, 0], ends_b[d, 0, 1], ends_b[d, 0, 2]
                near = grown_a[c] + grown_b[d] + gap
                if near > 0.0 and near * near > segment_distance(
                    u0,
                    u1,
                    u2,
                    ends_b[d, 1, 0] - q0,
                    ends_b[d, 1, 1] - q1,
                    ends_b[d, 1, 2] - q2,
                    p0 - q0,
                    p1 - q1,
                    p2 - q2,
                ):
                    return True
    return False


@njit(cache=True)
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
) -> int:
    """Copy a list of bodies behind itself but for those that stay apart on two stretches.

    Returns:
        How many are left; by capsules alone, all of them if any is.
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
    if np.isnan(slack):
        extra = 0.0 if single else MOTION
        if not _any_capsules_near(a_hulls, b_hulls, extra, descent, begin, end):
            return 0
        if single:
            where[begin:end] = np.nan
        return end - begin
    end = _keep_unseparated(a_hulls, b_hulls, slack - TOLERANCE, descent, begin, end)
    if not single:
        return end - begin
    kept = begin
    if begin < end:
        pose_segments(a_hulls, s, b_hulls, t, scratch)
    for e in range(begin, end):
        x, y, least = pairs[e, 0], pairs[e, 1], where[e, 0]
        scratch.direction[:] = 0.0
        if hulls_stay_apart(a_hulls, s, x, b_hulls, t, y, least - slack, scratch):
            continue
        pairs[kept, 0], pairs[kept, 1] = x, y
        where[kept] = scratch.where
        kept += 1
    return kept - begin


@njit(cache=True)
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
) -> tuple[int, int, int, int, int]:
    """Go on with a descent until two segments may conflict.

    Args:
        a, a_hulls: occupancy of the nodes v that may have to wait.
        b, b_hulls: occupancy of the nodes u that may have to be waited for.
        table: allowed contacts and clearances.
        slack: pairs of bodies whose hulls are proved to keep their clearance less this are
            dropped [m]; NaN to propose whatever the capsules do.
        floor: last u that each v waits for already, never falling, by node of ``a``.
        limit: first u that is not at stake for each v, never falling, by node of ``a``.
        descent: how far it has come.
        depth: filled rows of its stack.

    Returns:
        The new depth, the two segments, and where in ``descent.pairs`` the close pairs of
        bodies begin and how many they are; a number of 0 says that the descent is over.
    """
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
            )
            begin += count
            if kept == 0:
                continue
            if s_last - s == 1 and t_last - t == 1:
                return depth, s, t, begin, kept
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
    return 0, 0, 0, 0, 0


@njit(cache=True)
def raise_floor(floor: Indices, v: int, u: int) -> None:
    """Note that v, and so every later node of its robot, waits for u."""
    while v < len(floor) and floor[v] < u:
        floor[v] = u
        v += 1
