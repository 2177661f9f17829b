"""Search for bodies that come close on two motions (dual-tree descent), in compiled code, and its state.

Separating planes exclude pairs of bodies on stretches of both motions. Stretches are halved down to single segments;
for pairs that remain there, the distances of the convex hulls are computed.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np

from planning.geometry.exact import TOLERANCE
from planning.geometry.gjk import ROUNDING
from planning.geometry.separation import (
    APART,
    CONFLICT,
    Scratch,
    check_hulls_continuously,
    make_scratch,
    pose_segments,
)
from planning.geometry.stretches import (
    MIXED,
    PosedStretch,
    are_stretches_apart,
    make_stretch,
    measure_bodies,
    measure_deviation,
    pose_stretch,
)
from planning.kernels import inner_kernel
from planning.packed import packed
from planning.transforms import Array, Indices
from scheduling.conflicts.allowed_contacts import (
    ContactTable,
    is_contact_allowed,
    least_distance,
)
from scheduling.conflicts.swept_sequence import LEAF, SweptSequence

BLOCKS = -1
"""Marks a row of the stack as a pair of blocks."""

PROVED = -1
"""In the place of a number of bodies: there is a conflict for certain."""

_LEVELS = 2 * LEAF.bit_length() + 2
"""Lists of bodies that are needed simultaneously: one a halving of two leaves, and two more."""

_Sizes = tuple[int, ...]
_LEFT: defaultdict[tuple[_Sizes, _Sizes], list[DescentRoom]] = defaultdict(list)
"""Free work arrays, by the sizes of the compared occupancies."""

_KINDS = 200
"""Room of more sizes is not kept."""


class DescentRoom(NamedTuple):
    """Work arrays for a descent.

    Attributes:
        stack: what is still to be looked at: (block, -1, other block, -1, 0, 0), or two
            stretches and a list of bodies, (first, last, first, last, list, its length), shape
            (room, 6).
        pairs: lists of pairs (body of a, body of b), shape (room, 2).
        where: shares of both motions at which proposed pairs come close, shape (room, 2).
        on_a, on_b: stretches, posed.
        planes: direction in which two bodies were apart last, shape (bodies, bodies, 3).
        scratch: work array for the hulls.
    """

    stack: Indices
    pairs: Indices
    where: Array
    on_a: PosedStretch
    on_b: PosedStretch
    planes: Array
    scratch: Scratch


class Descent(NamedTuple):
    """State of a descent over two occupancies, with its work arrays.

    Attributes:
        a: occupancy of the nodes v that may have to wait.
        b: occupancy of the nodes u that may have to be waited for.
        table: allowed contacts and clearances.
        floor: last u that each v waits for already, non-decreasing, by node of ``a``; raised
            when conflicts are found.
        limit: first u outside the query for each v, non-decreasing, by node of ``a``.
        slack: subtracted from the clearances [m].
        room: to work in.
    """

    a: SweptSequence
    b: SweptSequence
    table: ContactTable
    floor: Indices
    limit: Indices
    slack: float
    room: DescentRoom


@contextmanager
def start_descent(
    a: SweptSequence,
    b: SweptSequence,
    table: ContactTable,
    floor: Indices,
    limit: Indices,
    slack: float,
) -> Iterator[Descent]:
    """Set up a descent from both roots, the first row of the stack.

    Its room is that of one that is over: making it would take as long as half of a descent.
    """
    sizes = _sizes(a), _sizes(b)
    try:  # other threads may take what is left in between
        room = _LEFT[sizes].pop()
    except IndexError:
        room = _make_room(a, b)
    room.stack[0] = 0, BLOCKS, 0, BLOCKS, 0, 0
    # Stretches and directions are numbered on: cached data never matches later ones.
    room.on_a.span[:2] = room.on_b.span[:2] = 0
    room.scratch.posed[:] = -1
    room.planes[:] = 0.0
    try:
        yield packed(Descent(a, b, table, floor, limit, float(slack), room))
    finally:
        if len(_LEFT) > _KINDS:
            _LEFT.clear()
        _LEFT[sizes].append(room)


def _sizes(of: SweptSequence) -> _Sizes:
    """Return the sizes that determine the work arrays of an occupancy."""
    hulls = of.hulls
    joints, bodies = hulls.q_a.shape[1], hulls.solid.shape[1]
    return joints, bodies, len(hulls.joint), len(hulls.radius), hulls.most_corners


def _make_room(a: SweptSequence, b: SweptSequence) -> DescentRoom:
    bodies = a.entity.shape[1], b.entity.shape[1]
    most = _LEVELS * bodies[0] * bodies[1]
    room = DescentRoom(
        np.empty((512, 6), dtype=np.int64),
        np.empty((most, 2), dtype=np.int64),
        np.empty((most, 2)),
        make_stretch(a.hulls),
        make_stretch(b.hulls),
        np.empty((*bodies, 3)),
        make_scratch(a.hulls, b.hulls),
    )
    return packed(room)


@inner_kernel
def keep_close_bodies(
    descent: Descent, s: int, s_last: int, t: int, t_last: int, first: int, count: int
) -> int:
    """Append the list of bodies without those proved apart on two stretches.

    Returns:
        How many are left; PROVED when two segments are proved to conflict.
    """
    a, b, table = descent.a, descent.b, descent.table
    a_hulls, b_hulls, room = a.hulls, b.hulls, descent.room
    pairs, where, scratch = room.pairs, room.where, room.scratch
    single = s_last - s == 1 and t_last - t == 1
    pose_stretch(a_hulls, s, s_last, room.on_a)
    pose_stretch(b_hulls, t, t_last, room.on_b)
    solid_a, solid_b = room.on_a.solid, room.on_b.solid
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
                and is_contact_allowed(
                    table, u, v, a.task[s], a.other_task[s], b.task[t], b.other_task[t]
                )
            ):
                continue
            least = least_distance(
                table, u, a_hulls.joint[one], v, b_hulls.joint[other]
            )
            measure_deviation(a_hulls, one, room.on_a)
            measure_deviation(b_hulls, other, room.on_b)
        pairs[end, 0], pairs[end, 1] = x, y
        where[end, 0] = least
        end += 1
    end = _keep_unseparated(descent, begin, end)
    if not single:
        return end - begin
    kept, direction = begin, scratch.direction
    if begin < end:
        pose_segments(a_hulls, s, b_hulls, t, scratch)
    for e in range(begin, end):
        x, y, least = pairs[e, 0], pairs[e, 1], where[e, 0]
        for r in range(3):
            direction[r] = 0.0
        answer = check_hulls_continuously(
            a_hulls, x, b_hulls, y, least - descent.slack, scratch
        )
        if answer == APART:
            continue
        if answer == CONFLICT:
            return PROVED
        pairs[kept, 0], pairs[kept, 1] = x, y
        where[kept, 0], where[kept, 1] = scratch.where[0], scratch.where[1]
        kept += 1
    return kept - begin


@inner_kernel
def _keep_unseparated(descent: Descent, first: int, end: int) -> int:
    """Drop the pairs of bodies that planes separate on two posed stretches.

    A plane found for one pair is tried on all others: few pairs need one of their own. More
    than the clearance is asked for, as much as the exact decision tolerates: so what it says
    of two segments does not depend on the stretches they were part of.

    Args:
        descent: with the clearances of the pairs in ``where``, infinite to keep a pair.
        first, end: the list of pairs.

    Returns:
        The new end of the list.
    """
    a, b, slack = descent.a.hulls, descent.b.hulls, descent.slack - TOLERANCE
    room = descent.room
    pairs, where = room.pairs, room.where
    on_a, on_b = room.on_a, room.on_b
    least_a, least_b = on_a.least, on_b.least
    known_a, known_b = on_a.measured, on_b.measured
    at = first
    while at < end:
        x, y, least = pairs[at, 0], pairs[at, 1], where[at, 0] - slack
        at += 1
        if least == np.inf:
            continue
        plane = room.planes[x, y]
        for attempt in range(2):
            if attempt == 1 and not are_stretches_apart(
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
