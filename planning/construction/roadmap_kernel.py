"""The earliest arrival over a roadmap, compiled: which way, and when to wait where.

Vertices are configurations, each with the spans of time in which one may stand there. The
search goes from span to span in order of earliest arrival (safe-interval path planning), and
looks at a motion only once nothing else promises an earlier arrival. A motion that a robot is in
the way of is looked at again for when that robot has left. It finds ways that a tree in
space-time has to be lucky to find: any wait at any vertex.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from planning.construction.arena import Arena, Integers, column
from planning.construction.free_cells import spans_of, strike_out
from planning.construction.motion_queue import Motions, no_motions, pop, push
from planning.construction.rrt_kernel import (
    Query,
    least_time,
    next_arrival,
    random_share,
    sample_between,
)
from planning.construction.space_time_kernel import (
    left_by_robots,
    lies_throughout,
    met_by_robots,
    motion_clear,
    still_clear_until,
)
from planning.construction.space_time_scene import BEGIN
from planning.transforms import Array

_TINY = 1e-9
_SPANS = 12
"""Spans kept at one vertex."""

_TRIES = 5
"""Departures tried from one span to another."""

_LATER = 0.4
"""A second departure is so much later at least, a third one twice as much... [s]."""

_UNKNOWN = -1
"""Instead of tries: it is not known yet when one may stand where the motion ends."""

_LEEWAY = 4.0
"""What is clear of all that lies still for so long needs no second look within that time [s]."""

_CLEAR, _NOT_NOW, _BLOCKED = 1, 0, -1
"""Answers of ``_look``."""

_GREED = 1.0
"""Weight of the time that is left against the time that has passed."""


@njit(cache=True, nogil=True)
def arrive(query: Query, a: Array, t: float, b: Array) -> float:
    """Return when one can be at ``b`` who leaves ``a`` at time ``t`` [s]."""
    out = t
    for j in range(len(a)):
        travel = abs(b[j] - a[j])
        if travel > 0.0:
            out = max(out, max(t, query.begin[j]) + travel / query.velocity[j])
    return out


@njit(cache=True, nogil=True)
def _normal(state: npt.NDArray[np.uint64]) -> float:
    """Return a random number that is nearly normal: the sum of a few uniform ones."""
    total = -3.0
    for _ in range(6):
        total += random_share(state)
    return 1.4142 * total


class Roadmap(NamedTuple):
    """Vertices, and how far the search has come at each.

    Attributes:
        q: shape (v, n).
        number: spans of each vertex, -1 where they are not known yet, shape (v,).
        spans: when one may stand there, shape (v, _SPANS, 2) [s].
        come: when one is there, infinity where that is not known, shape (v, _SPANS) [s].
        left: when one left the vertex before, likewise [s].
        parent: which span of which vertex that was, likewise.
        rest: least time from there to a goal, shape (v,) [s].
        blocked: motions that are not clear of what lies still, shape (v, v).
        still: departure from which on, for _LEEWAY, a motion is clear of it, infinity where that
            is not known, shape (v, v) [s].
        free: room to work in, shape (cells,).
    """

    q: Array
    number: Integers
    spans: Array
    come: Array
    left: Array
    parent: Integers
    rest: Array
    blocked: npt.NDArray[np.bool_]
    still: Array
    free: npt.NDArray[np.bool_]


@njit(cache=True, nogil=True)
def search_roadmap(
    scene: Arena,
    query: Query,
    extra: Array,
    vertices: int,
    neighbours: int,
    checks: int,
    step: float,
    depart: float,
    bound: float,
    wide: float,
    seed: int,
) -> tuple[Array, Array, int, int]:
    """Return a path with an early arrival over a random roadmap.

    Args:
        scene: what must be kept clear of.
        query: what is asked for.
        extra: configurations that become vertices, such as those of a path, shape (e, n).
        vertices: in all, at least start, goals and extra ones.
        neighbours: nearest vertices that motions from one lead to.
        checks: motions checked at most.
        step: length of the cells of time [s].
        depart: the movers stand until then, or as long as they may [s].
        bound: only an arrival before this is of use [s].
        wide: configurations are drawn from which a goal can be reached by then [s].
        seed: of the random configurations.

    Returns:
        Times and configurations, shapes (w,) and (w, n), empty where there is no path; its
        goal; and motions checked.
    """
    n, goals = len(query.start), len(query.goals)
    start = np.min(query.begin)
    first = int(np.floor(start / step + 1e-6))
    cells = max(int(np.ceil(bound / step)) - first, 1)
    road = _draw(scene, query, extra, vertices, cells, wide, seed)
    # It begins where it stands, even where it has to leave at once.
    _stand(scene, road, 0, first, step)
    if road.number[0] == 0 or road.spans[0, 0, 0] > start + _TINY:
        road.spans[0, 0] = start
        road.number[0] = 1
    heap = no_motions()
    road.come[0, 0] = max(start, min(depart, road.spans[0, 0, 1]))
    best, last = bound, -1
    at = next_arrival(query, 0, np.inf)
    checked = 0
    state = 0
    order = np.empty(len(road.q))
    known = goals + len(extra)
    while True:
        v, i = state // _SPANS, state % _SPANS
        if 1 <= v <= goals:
            at = next_arrival(query, v - 1, road.come[v, i])
            if at <= road.spans[v, i, 1] + _TINY and at < best - _TINY:
                best, last = at, state
        for k in range(len(road.q)):
            order[k] = (
                np.inf
                if road.blocked[v, k]
                else arrive(query, road.q[v], start, road.q[k])
            )
        order[v] = np.inf
        # The goals first, and from ways given to ways given, then the nearest vertices.
        given = goals if 0 < v <= goals or v > known else known
        for turn in range(given + neighbours):
            u = turn + 1
            if turn >= given:
                u = int(np.argmin(order))
            if order[u] == np.inf:
                continue
            same = order[u] <= start + _TINY
            order[u] = np.inf
            if same:
                continue
            if road.number[u] < 0:
                _offer_unknown(query, road, heap, state, u, road.come[v, i], best)
            for j in range(road.number[u]):
                _offer(
                    query, road, heap, state, u * _SPANS + j, road.come[v, i], 0, best
                )
        state = -1
        while heap.size[0] > 0 and checked < checks and heap.key[0] < best - _TINY:
            depart, source, target, tries = (
                heap.depart[0],
                heap.edge[0, 0],
                heap.edge[0, 1],
                heap.edge[0, 2],
            )
            pop(heap)
            v, u, j = source // _SPANS, target // _SPANS, target % _SPANS
            if road.blocked[v, u]:
                continue
            if tries == _UNKNOWN:
                if road.number[u] < 0:
                    _stand(scene, road, u, first, step)
                for k in range(road.number[u]):
                    _offer(query, road, heap, source, u * _SPANS + k, depart, 0, best)
                continue
            if road.come[u, j] < np.inf:
                continue
            arrival = arrive(query, road.q[v], depart, road.q[u])
            checked += 1
            found, met = _look(scene, road, v, depart, u, arrival)
            if found == _CLEAR:
                road.come[u, j], road.left[u, j] = arrival, depart
                road.parent[u, j] = source
                state = target
                break
            if tries == 0 and found == _BLOCKED:
                road.blocked[v, u] = road.blocked[u, v] = True
                continue
            if tries + 1 < _TRIES:
                later = np.floor(depart / step + 1e-6) * step + _LATER * (1 << tries)
                if met < np.inf:
                    share = (met - depart) / (arrival - depart)
                    there = road.q[v] + share * (road.q[u] - road.q[v])
                    until = left_by_robots(scene, there, met, best)
                    later = max(later, depart + until - met)
                _offer(query, road, heap, source, target, later, tries + 1, best)
        if state < 0:
            break
    if last < 0:
        return np.empty(0), np.empty((0, n)), -1, checked
    times, path = _trace(road, last, best)
    times[0] = start
    return times, path, last // _SPANS - 1, checked


@njit(cache=True, nogil=True)
def _draw(
    scene: Arena,
    query: Query,
    extra: Array,
    vertices: int,
    cells: int,
    wide: float,
    seed: int,
) -> Roadmap:
    """Draw the vertices: start, goals, extra ones, and random ones."""
    n, goals = len(query.start), len(query.goals)
    state = np.zeros(1, dtype=np.uint64)
    state[0] = np.uint64(seed) * np.uint64(7919) + np.uint64(11)
    start = np.min(query.begin)
    q = np.empty((vertices, n))
    q[0] = query.start
    q[1 : 1 + goals] = query.goals
    number = 1 + goals
    for e in range(len(extra)):
        if number < vertices:
            q[number] = extra[e]
            number += 1
    tries = 0
    while number < vertices and tries < 3 * vertices:
        tries += 1
        goal = int(random_share(state) * goals)
        kind = random_share(state)
        if kind < 0.35:
            # Where it must leave soon, or can only come late, short ways are what is free; and
            # an arm that reaches over something leaves by driving away, as it is.
            near = int(random_share(state) * (1 + goals))
            far = 0.2 + 2.0 * random_share(state)
            drives = random_share(state) < 0.6 and not np.all(query.leans)
            for j in range(n):
                at = 2.0 * random_share(state) - 1.0
                if drives and query.leans[j]:
                    at = 0.0
                at = q[near, j] + far * query.velocity[j] * at
                q[number, j] = min(max(at, query.lower[j]), query.upper[j])
        elif kind < 0.85:
            sample_between(query, goal, wide, state, q[number])
        else:
            share = random_share(state)
            spread = 0.25 * random_share(state)
            for j in range(n):
                middle = query.start[j] + share * (
                    query.goals[goal, j] - query.start[j]
                )
                far = spread * min(
                    query.upper[j] - query.lower[j],
                    query.velocity[j] * max(wide - query.begin[j], 0.0),
                )
                at = middle + far * _normal(state)
                q[number, j] = min(max(at, query.lower[j]), query.upper[j])
        clear, _ = still_clear_until(scene, q[number], start, q[number], start, 0.0)
        if clear:
            number += 1
    q, vertices = q[:number], number
    rest = np.full(vertices, np.inf)
    for k in range(vertices):
        for g in range(goals):
            rest[k] = min(rest[k], least_time(query, q[k], start, g) - start)
    return Roadmap(
        q,
        np.full(vertices, -1, dtype=np.int64),
        np.empty((vertices, _SPANS, 2)),
        np.full((vertices, _SPANS), np.inf),
        np.full((vertices, _SPANS), np.inf),
        np.full((vertices, _SPANS), -1, dtype=np.int64),
        rest,
        np.zeros((vertices, vertices), dtype=np.bool_),
        np.full((vertices, vertices), np.inf),
        np.empty(cells, dtype=np.bool_),
    )


@njit(cache=True, nogil=True)
def _look(
    scene: Arena, road: Roadmap, v: int, depart: float, u: int, arrival: float
) -> tuple[int, float]:
    """Tell whether a motion is clear, and else whether what lies still is in its way.

    Returns:
        The answer, and when a robot is met, infinity where that is not known [s].
    """
    a, b = road.q[v], road.q[u]
    if len(column(scene, BEGIN)) > 1:
        if motion_clear(scene, a, depart, b, arrival):
            return _CLEAR, np.inf
        still, _ = still_clear_until(scene, a, depart, b, arrival, 0.0)
        return (_NOT_NOW if still else _BLOCKED), np.inf
    if not 0.0 <= depart - road.still[v, u] <= _LEEWAY:
        # It will be asked for again, for a later departure: that is why what comes to lie there
        # meanwhile is looked at, too.
        until = arrival + _LEEWAY
        still, _ = still_clear_until(scene, a, depart, b, until, until - depart)
        if still:
            road.still[v, u] = depart
        elif (
            lies_throughout(scene, depart, until)
            or not still_clear_until(scene, a, depart, b, arrival, 0.0)[0]
        ):
            return _BLOCKED, np.inf
    met = met_by_robots(scene, a, depart, b, arrival)
    return (_CLEAR if met == np.inf else _NOT_NOW), met


@njit(cache=True, nogil=True)
def _stand(scene: Arena, road: Roadmap, v: int, first: int, step: float) -> None:
    """Work out when one may stand at a vertex."""
    road.free[:] = True
    strike_out(scene, road.q[v], road.q[v], first, step, road.free)
    road.number[v] = spans_of(road.free, first, step, road.spans[v])


@njit(cache=True, nogil=True)
def _offer(
    query: Query,
    road: Roadmap,
    heap: Motions,
    source: int,
    target: int,
    depart: float,
    tries: int,
    bound: float,
) -> None:
    """Let a motion wait to be looked at, if it may be of use."""
    v, i = source // _SPANS, source % _SPANS
    u, j = target // _SPANS, target % _SPANS
    lo, hi = road.spans[u, j]
    arrival = arrive(query, road.q[v], depart, road.q[u])
    if arrival < lo:
        # As late as that it need not even leave.
        depart = depart + lo - arrival
        arrival = arrive(query, road.q[v], depart, road.q[u])
    if (
        depart > road.spans[v, i, 1] + _TINY
        or arrival > hi
        or arrival + road.rest[u] >= bound - _TINY
        or road.come[u, j] <= arrival
    ):
        return
    push(heap, arrival + _GREED * road.rest[u], depart, source, target, tries)


@njit(cache=True, nogil=True)
def _offer_unknown(
    query: Query,
    road: Roadmap,
    heap: Motions,
    source: int,
    u: int,
    depart: float,
    bound: float,
) -> None:
    """Let a motion to a vertex wait until it matters when one may stand there."""
    arrival = arrive(query, road.q[source // _SPANS], depart, road.q[u])
    if arrival + road.rest[u] < bound - _TINY:
        key = arrival + _GREED * road.rest[u]
        push(heap, key, depart, source, u * _SPANS, _UNKNOWN)


@njit(cache=True, nogil=True)
def _trace(road: Roadmap, last: int, best: float) -> tuple[Array, Array]:
    """Return the path that leads to a span of a vertex."""
    count = 1
    k = last
    while road.parent[k // _SPANS, k % _SPANS] >= 0:
        count += 1
        k = road.parent[k // _SPANS, k % _SPANS]
    times, path = np.empty(2 * count), np.empty((2 * count, road.q.shape[1]))
    k = last
    leave = best
    for c in range(count - 1, -1, -1):
        v, i = k // _SPANS, k % _SPANS
        times[2 * c], times[2 * c + 1] = road.come[v, i], leave
        path[2 * c], path[2 * c + 1] = road.q[v], road.q[v]
        leave = road.left[v, i]
        k = road.parent[v, i]
    return times, path
