"""Dual-tree descent over two swept sequences: proposes conflicts, latest of the other first.

With two robots the conflicts that matter form a staircase: for each node the last node of the
other robot before it that comes too close, unless an earlier node waits for as much already.
Blocks are pruned when their volumes are apart, when nothing in them is at stake (outside the
window from ``floor`` to ``limit``), and, as edges are found, when these imply the rest.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit

from planning.geometry.distance import segment_segment
from planning.geometry.separation import (
    HullTable,
    Scratch,
    hulls_stay_apart,
    pose_segments,
)
from planning.transforms import Array
from scheduling.contacts import ContactTable, may_touch
from scheduling.swept_sequence import SweptSequence
from scheduling.temporal_plan_graph import Indices

ROOM = 4096
"""Pairs of bodies that a proposal has room for; the rest is never needed to refuse it."""


@njit(cache=True)
def _boxes_apart(
    a_low: Array, a_high: Array, b_low: Array, b_high: Array, gap: float
) -> bool:
    for k in range(3):
        if a_low[k] - b_high[k] > gap or b_low[k] - a_high[k] > gap:
            return True
    return False


@njit(cache=True)
def _capsule_off_box(p: Array, q: Array, r: float, low: Array, high: Array) -> bool:
    for k in range(3):
        if min(p[k], q[k]) - r > high[k] or max(p[k], q[k]) + r < low[k]:
            return True
    return False


@njit(cache=True)
def _blocks_apart(
    a: SweptSequence, i: int, b: SweptSequence, j: int, gap: float
) -> bool:
    if _boxes_apart(
        a.block_low[i], a.block_high[i], b.block_low[j], b.block_high[j], gap
    ):
        return True
    for c in range(a.block_radius.shape[1]):
        r = a.block_radius[i, c]
        if r < 0.0 or _capsule_off_box(
            a.block_start[i, c],
            a.block_end[i, c],
            r + gap,
            b.block_low[j],
            b.block_high[j],
        ):
            continue
        for d in range(b.block_radius.shape[1]):
            s = b.block_radius[j, d]
            if s < 0.0:
                continue
            near = r + s + gap
            if _capsules_boxes_apart(
                a.block_start[i, c],
                a.block_end[i, c],
                b.block_start[j, d],
                b.block_end[j, d],
                near,
            ):
                continue
            if (
                segment_segment(
                    a.block_start[i, c],
                    a.block_end[i, c],
                    b.block_start[j, d],
                    b.block_end[j, d],
                )
                < near * near
            ):
                return False
    return True


@njit(cache=True)
def _capsules_boxes_apart(
    a0: Array, a1: Array, b0: Array, b1: Array, near: float
) -> bool:
    for k in range(3):
        if min(a0[k], a1[k]) - max(b0[k], b1[k]) > near:
            return True
        if min(b0[k], b1[k]) - max(a0[k], a1[k]) > near:
            return True
    return False


@njit(cache=True)
def close_bodies(
    a: SweptSequence,
    s: int,
    b: SweptSequence,
    t: int,
    table: ContactTable,
    out: npt.NDArray[np.int64],
) -> int:
    """Write the pairs of bodies of two segments whose capsules come too close.

    Args:
        a, s: a sequence and a segment of it.
        b, t: the other sequence and a segment of it.
        table: allowed contacts and clearances.
        out: room for pairs (body of a, body of b), shape (room, 2).

    Returns:
        The number of pairs.
    """
    count = 0
    gap = max(table.clearance[0], table.clearance[1])
    for c in range(a.radius.shape[1]):
        r = a.radius[s, c]
        if r < 0.0 or _capsule_off_box(
            a.start[s, c], a.end[s, c], r + gap, b.low[t], b.high[t]
        ):
            continue
        body = a.body[c]
        x = a.entity[s, body]
        for d in range(b.radius.shape[1]):
            q = b.radius[t, d]
            if q < 0.0:
                continue
            other = b.body[d]
            y = b.entity[t, other]
            limit = (
                table.clearance[0]
                if x < table.robots and y < table.robots
                else table.clearance[1]
            )
            near = r + q + limit
            if near < 0.0 or _capsules_boxes_apart(
                a.start[s, c], a.end[s, c], b.start[t, d], b.end[t, d], near
            ):
                continue
            if a.still[s, body] and b.still[t, other]:
                continue
            if (
                segment_segment(a.start[s, c], a.end[s, c], b.start[t, d], b.end[t, d])
                >= near * near
            ):
                continue
            seen = False
            for e in range(count):
                if out[e, 0] == body and out[e, 1] == other:
                    seen = True
                    break
            if seen or may_touch(
                table, x, y, a.task[s], a.other_task[s], b.task[t], b.other_task[t]
            ):
                continue
            if count < out.shape[0]:
                out[count, 0], out[count, 1] = body, other
                count += 1
    return count


@njit(cache=True)
def _keep_close_hulls(
    a: SweptSequence,
    a_hulls: HullTable,
    s: int,
    b: SweptSequence,
    b_hulls: HullTable,
    t: int,
    table: ContactTable,
    slack: float,
    out: npt.NDArray[np.int64],
    where: Array,
    count: int,
    scratch: Scratch,
) -> int:
    """Drop the pairs of bodies whose hulls are proved to stay apart; return what is left."""
    left = 0
    if count > 0:
        pose_segments(a_hulls, s, b_hulls, t, scratch)
    for e in range(count):
        i, j = out[e, 0], out[e, 1]
        robots = a.entity[s, i] < table.robots and b.entity[t, j] < table.robots
        limit = table.clearance[0] if robots else table.clearance[1]
        if not hulls_stay_apart(a_hulls, s, i, b_hulls, t, j, limit - slack, scratch):
            out[left, 0], out[left, 1] = i, j
            where[left, 0], where[left, 1] = scratch.where[0], scratch.where[1]
            left += 1
    return left


@njit(cache=True)
def next_proposal(
    a: SweptSequence,
    a_hulls: HullTable,
    b: SweptSequence,
    b_hulls: HullTable,
    table: ContactTable,
    slack: float,
    floor: Indices,
    limit: Indices,
    stack: npt.NDArray[np.int64],
    depth: int,
    out: npt.NDArray[np.int64],
    where: Array,
    scratch: Scratch,
) -> tuple[int, int, int, int]:
    """Go on with a descent until two segments may conflict.

    Args:
        a, a_hulls: occupancy of the nodes v that may have to wait.
        b, b_hulls: occupancy of the nodes u that may have to be waited for.
        table: allowed contacts and clearances.
        slack: pairs of bodies whose hulls are proved to keep their clearance less this are
            dropped [m]; NaN to propose whatever the capsules do.
        floor: last u that each v waits for already, never falling, by node of ``a``.
        limit: first u that is not at stake for each v, never falling, by node of ``a``.
        stack: pairs still to be looked at: blocks, or segments when negative, shape (room, 2).
        depth: filled rows of ``stack``.
        out: room for the pairs of bodies.
        where: room for the shares of both motions at which each pair comes close; written
            unless ``slack`` is NaN, shape (room, 2).
        scratch: room for the hulls.

    Returns:
        The new depth, the two segments, and the number of pairs of bodies; a number of 0 says
        that the descent is over.
    """
    gap = max(table.clearance[0], table.clearance[1])
    leaf_a, leaf_b = len(a.block_first) // 2, len(b.block_first) // 2
    while depth > 0:
        depth -= 1
        i, j = stack[depth, 0], stack[depth, 1]
        if i < 0:
            s, t = -1 - i, -1 - j
            v, u = a.node[s], b.node[t]
            if u <= floor[v] or u >= limit[v]:
                continue
            if _boxes_apart(a.low[s], a.high[s], b.low[t], b.high[t], gap):
                continue
            count = close_bodies(a, s, b, t, table, out)
            if not np.isnan(slack):
                count = _keep_close_hulls(
                    a,
                    a_hulls,
                    s,
                    b,
                    b_hulls,
                    t,
                    table,
                    slack,
                    out,
                    where,
                    count,
                    scratch,
                )
            if count > 0:
                return depth, s, t, count
            continue
        a_first, a_last = a.block_first[i], a.block_last[i]
        b_first, b_last = b.block_first[j], b.block_last[j]
        if a_first >= a_last or b_first >= b_last:
            continue
        if b.node[b_last - 1] <= floor[a.node[a_first]]:
            continue
        if b.node[b_first] >= limit[a.node[a_last - 1]]:
            continue
        if _blocks_apart(a, i, b, j, gap):
            continue
        if i >= leaf_a and j >= leaf_b:
            # The top of the stack comes next: earliest v first, latest u first.
            for s in range(a_last - 1, a_first - 1, -1):
                v = a.node[s]
                for t in range(b_first, b_last):
                    u = b.node[t]
                    if floor[v] < u < limit[v] and not _boxes_apart(
                        a.low[s], a.high[s], b.low[t], b.high[t], gap
                    ):
                        stack[depth, 0], stack[depth, 1] = -1 - s, -1 - t
                        depth += 1
        elif j >= leaf_b or (i < leaf_a and a_last - a_first >= b_last - b_first):
            stack[depth, 0], stack[depth, 1] = 2 * i + 2, j
            stack[depth + 1, 0], stack[depth + 1, 1] = 2 * i + 1, j
            depth += 2
        else:
            stack[depth, 0], stack[depth, 1] = i, 2 * j + 1
            stack[depth + 1, 0], stack[depth + 1, 1] = i, 2 * j + 2
            depth += 2
    return 0, 0, 0, 0


@njit(cache=True)
def raise_floor(floor: Indices, v: int, u: int) -> None:
    """Note that v, and so every later node of its robot, waits for u."""
    while v < len(floor) and floor[v] < u:
        floor[v] = u
        v += 1
