"""The earliest arrival over a roadmap, compiled: which way, and when to wait where.

Vertices are configurations, each with the spans of time in which one may stand there. The
search goes from span to span in order of earliest arrival (safe-interval path planning). Motions
are checked only when the search comes to them. It finds ways that a tree in space-time has to be
lucky to find: any wait at any vertex.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit

from planning.construction.arena import Arena, Integers
from planning.construction.free_cells import spans_of, strike_out
from planning.construction.rrt_kernel import (
    Query,
    least_time,
    next_arrival,
    random_share,
    sample_between,
)
from planning.construction.space_time_kernel import motion_clear
from planning.transforms import Array

_TINY = 1e-9
_SPANS = 12
"""Spans kept at one vertex."""

_TRIES = 6
"""Departures tried from one span to another."""


@njit(cache=True)
def arrive(query: Query, a: Array, t: float, b: Array) -> float:
    """Return when one can be at ``b`` who leaves ``a`` at time ``t`` [s]."""
    out = t
    for j in range(len(a)):
        travel = abs(b[j] - a[j])
        if travel > 0.0:
            out = max(out, max(t, query.begin[j]) + travel / query.velocity[j])
    return out


@njit(cache=True)
def _normal(state: npt.NDArray[np.uint64]) -> float:
    """Return a random number that is nearly normal: the sum of a few uniform ones."""
    total = -3.0
    for _ in range(6):
        total += random_share(state)
    return 1.4142 * total


@njit(cache=True)
def search_roadmap(
    scene: Arena,
    query: Query,
    extra: Array,
    vertices: int,
    neighbours: int,
    checks: int,
    step: float,
    bound: float,
    seed: int,
) -> tuple[Array, Array, int, int]:
    """Return the path with the earliest arrival over a random roadmap.

    Args:
        scene: what must be kept clear of.
        query: what is asked for.
        extra: configurations that become vertices, such as those of a path, shape (e, n).
        vertices: in all, at least start, goals and extra ones.
        neighbours: nearest vertices that motions from one lead to.
        checks: motions checked at most.
        step: departures are tried at this distance, and twice, four times... of it [s].
        bound: only an arrival before this is of use [s].
        seed: of the random configurations.

    Returns:
        Times and configurations, shapes (w,) and (w, n), empty where there is no path; its
        goal; and motions checked.
    """
    n = len(query.start)
    goals = len(query.goals)
    start = np.min(query.begin)
    state = np.zeros(1, dtype=np.uint64)
    state[0] = np.uint64(seed) * np.uint64(7919) + np.uint64(11)
    first = int(np.floor(start / step + 1e-6))
    cells = max(int(np.ceil(bound / step)) - first, 1)
    free = np.empty(cells, dtype=np.bool_)
    q = np.empty((vertices, n))
    spans = np.empty((vertices, _SPANS, 2))
    counts = np.zeros(vertices, dtype=np.int64)
    q[0] = query.start
    for g in range(goals):
        q[1 + g] = query.goals[g]
    number = 1 + goals
    for e in range(len(extra)):
        if number < vertices:
            q[number] = extra[e]
            number += 1
    given = number
    tries = 0
    while number < vertices and tries < 3 * vertices:
        tries += 1
        goal = int(random_share(state) * goals)
        if random_share(state) < 0.5:
            sample_between(query, goal, bound, state, q[number])
        else:
            share = random_share(state)
            wide = 0.25 * random_share(state)
            for j in range(n):
                middle = query.start[j] + share * (
                    query.goals[goal, j] - query.start[j]
                )
                spread = wide * min(
                    query.upper[j] - query.lower[j],
                    query.velocity[j] * (bound - query.begin[j]),
                )
                at = middle + spread * _normal(state)
                q[number, j] = min(max(at, query.lower[j]), query.upper[j])
        free[:] = True
        strike_out(scene, q[number], q[number], first, step, free)
        counts[number] = spans_of(free, first, step, spans[number])
        if counts[number] > 0:
            number += 1
    for k in range(given):
        free[:] = True
        strike_out(scene, q[k], q[k], first, step, free)
        counts[k] = spans_of(free, first, step, spans[k])
    if counts[0] == 0 or spans[0, 0, 0] > start + _TINY:
        # It cannot stay where it is, and has to leave at once.
        spans[0, 0] = start
        counts[0] = 1
    come = np.full((number, _SPANS), np.inf)
    left = np.full((number, _SPANS), np.inf)
    parent = np.full((number, _SPANS), -1, dtype=np.int64)
    done = np.zeros((number, _SPANS), dtype=np.bool_)
    rest = np.empty(number)
    for k in range(number):
        rest[k] = np.inf
        for g in range(goals):
            rest[k] = min(rest[k], least_time(query, q[k], start, g) - start)
    come[0, 0] = start
    best, last = bound, -1
    checked = 0
    far = np.empty(number)
    while checked < checks:
        v, i, soon = -1, -1, best
        for k in range(number):
            for s in range(counts[k]):
                if not done[k, s] and come[k, s] + rest[k] < soon:
                    v, i, soon = k, s, come[k, s] + rest[k]
        if v < 0:
            break
        done[v, i] = True
        if 1 <= v <= goals:
            at = next_arrival(query, v - 1, come[v, i])
            if at <= spans[v, i, 1] + _TINY and at < best - _TINY:
                best, last = at, v * _SPANS + i
        for k in range(number):
            far[k] = arrive(query, q[v], start, q[k]) - start
        far[v] = np.inf
        for turn in range(neighbours + goals):
            # The goals first, then the nearest vertices.
            u = turn + 1
            if turn >= goals:
                u = int(np.argmin(far))
            if far[u] == np.inf:
                continue
            far[u] = np.inf
            for j in range(counts[u]):
                checked += _reach(
                    scene,
                    query,
                    q,
                    spans,
                    come,
                    left,
                    parent,
                    v,
                    i,
                    u,
                    j,
                    step,
                    best - rest[u],
                )
    if last < 0:
        return np.empty(0), np.empty((0, n)), -1, checked
    return _trace(q, come, left, parent, last, best, checked)


@njit(cache=True)
def _reach(
    scene: Arena,
    query: Query,
    q: Array,
    spans: Array,
    come: Array,
    left: Array,
    parent: Integers,
    v: int,
    i: int,
    u: int,
    j: int,
    step: float,
    bound: float,
) -> int:
    """Try to come from a span of a vertex into one of another earlier; return motions checked."""
    lo, hi = spans[u, j]
    depart = come[v, i]
    arrival = arrive(query, q[v], depart, q[u])
    if arrival < lo:
        # As late as that it need not even leave.
        depart = max(depart, depart + lo - arrival)
        arrival = arrive(query, q[v], depart, q[u])
    stride = step
    checked = 0
    for _ in range(_TRIES):
        if (
            depart > spans[v, i, 1] + _TINY
            or arrival > hi
            or arrival >= min(come[u, j], bound) - _TINY
        ):
            break
        if arrival >= lo - _TINY:
            checked += 1
            if motion_clear(scene, q[v], depart, q[u], arrival):
                come[u, j] = arrival
                left[u, j] = depart
                parent[u, j] = v * _SPANS + i
                break
        depart = (np.floor(depart / step + 1e-6)) * step + stride
        stride *= 2.0
        arrival = arrive(query, q[v], depart, q[u])
    return checked


@njit(cache=True)
def _trace(
    q: Array,
    come: Array,
    left: Array,
    parent: Integers,
    last: int,
    best: float,
    checked: int,
) -> tuple[Array, Array, int, int]:
    """Return the path that leads to a span of a vertex."""
    count = 1
    k = last
    while parent[k // _SPANS, k % _SPANS] >= 0:
        count += 1
        k = parent[k // _SPANS, k % _SPANS]
    times, path = np.empty(2 * count), np.empty((2 * count, q.shape[1]))
    k = last
    leave = best
    for c in range(count - 1, -1, -1):
        v, i = k // _SPANS, k % _SPANS
        times[2 * c], times[2 * c + 1] = come[v, i], leave
        path[2 * c], path[2 * c + 1] = q[v], q[v]
        leave = left[v, i]
        k = parent[v, i]
    return times, path, last // _SPANS - 1, checked
