"""Safe-interval path planning over a roadmap, in compiled code: motions along edges, and waits at vertices.

Vertices are configurations. Each has safe intervals: time spans in which the robot can stay there without collision.
The search expands intervals in the order of earliest arrival. A motion is checked for collisions only when no other
candidate promises an earlier arrival. If a robot blocks a motion, the motion is queued again for the time when that
robot has left. Waits of any length are possible at every vertex, so the search finds paths that a space-time RRT
rarely finds.
"""

from __future__ import annotations

import numpy as np

from planning.construction.checks.moving_checks import (
    earliest_free_time,
    first_conflict_time,
)
from planning.construction.checks.scene import MoverScene
from planning.construction.checks.still_checks import is_clear_of_still_objects
from planning.construction.paths.motion_queue import (
    Motions,
    empty_motions,
    pop_motion,
    push_motion,
)
from planning.construction.paths.query import (
    Query,
    arrival_time,
    next_arrival,
    tree_branch,
)
from planning.construction.paths.roadmap import (
    SPANS,
    Roadmap,
    draw_vertices,
    find_stands,
    new_roadmap,
)
from planning.construction.problem.settings import RrtSettings
from planning.kernels import ZERO, copy_row, inner_kernel, kernel
from planning.transforms import Array

_TINY = 1e-9
_TRIES = 5
"""Departures tried from one span to another."""

_LATER = 0.4
"""Least delay between departures; doubled for each further one [s]."""

_UNKNOWN = ZERO - 1
"""In place of tries: the safe intervals of the end vertex are unknown yet."""


def search_roadmap(
    scene: MoverScene,
    query: Query,
    settings: RrtSettings,
    extra: Array,
    depart: float,
    bound: float,
    wide: float,
    seed: int,
) -> tuple[Array, Array, int]:
    """Return a path with an early arrival over a random roadmap.

    Args:
        scene: what must be kept clear of.
        query: the query.
        settings: effort.
        extra: configurations that become vertices, such as those of a path, shape (e, n).
        depart: the robot stands until then, or as long as it may [s].
        bound: only an arrival before this is of use [s].
        wide: latest arrival for which configurations are drawn [s].
        seed: of the random configurations.

    Returns:
        Times and configurations, shapes (w,) and (w, n), empty where there is no path; and its
        goal.
    """
    known = len(query.goals) + len(extra)
    vertices = max(settings.vertices, 1 + known)
    q, rest = draw_vertices(scene, query, extra, vertices, wide, seed)
    first = int(np.floor(query.begin / scene.step + 1e-6))
    cells = max(int(np.ceil(bound / scene.step)) - first, 1)
    road, heap = new_roadmap(q, rest, cells), empty_motions()
    found: tuple[Array, Array, int] = _search(
        scene, query, settings, road, heap, known, first, depart, bound
    )
    return found


@kernel
def _search(
    scene: MoverScene,
    query: Query,
    settings: RrtSettings,
    road: Roadmap,
    heap: Motions,
    known: int,
    first: int,
    depart: float,
    bound: float,
) -> tuple[Array, Array, int]:
    """Search an unexplored roadmap, see ``search_roadmap``.

    Args:
        scene: what must be kept clear of.
        query: the query.
        settings: effort.
        road: the roadmap: the start, goals, vertices given, and random ones.
        heap: an empty one.
        known: number of given goals and vertices.
        first: step of the scene in which the robot starts.
        depart: the robot stands until then, or as long as it may [s].
        bound: only an arrival before this is of use [s].
    """
    n, goals, start = len(query.start), len(query.goals), query.begin
    # It begins where it stands, even where it has to leave immediately.
    find_stands(scene, road, ZERO, first)
    if road.number[0] == 0 or road.spans[0, 0, 0] > start + _TINY:
        road.spans[0, 0] = start
        road.number[0] = 1
    road.come[0, 0] = max(start, min(depart, road.spans[0, 0, 1]))
    best, last = bound, -1
    checked = state = ZERO
    while state >= 0:
        v, i = state // SPANS, state % SPANS
        if 1 <= v <= goals:
            at = next_arrival(query, v - 1, road.come[v, i])
            if at <= road.spans[v, i, 1] + _TINY and at < best - _TINY:
                best, last = at, state
        _offer_neighbours(query, road, heap, state, known, settings.neighbours, best)
        state, checked = _next_state(
            scene, query, road, heap, checked, settings.checks, best
        )
    if last < 0:
        return np.empty(0), np.empty((0, n)), -1
    times, path = _trace(road, last, best)
    times[0] = start
    return times, path, last // SPANS - 1


@inner_kernel
def _offer_neighbours(
    query: Query,
    road: Roadmap,
    heap: Motions,
    state: int,
    known: int,
    neighbours: int,
    bound: float,
) -> None:
    """Queue motions from a safe interval of a vertex to given vertices and to the nearest ones.

    Args:
        query: the query.
        road: the roadmap: the start, goals, vertices given, and random ones.
        heap: motions that wait.
        state: the span, ``vertex * SPANS`` and more.
        known: number of given goals and vertices.
        neighbours: how many of the nearest vertices.
        bound: only an arrival before this is of use [s].
    """
    v, start = state // SPANS, query.begin
    depart, goals = road.come[v, state % SPANS], len(query.goals)
    order = np.full(len(road.q), np.inf)
    for k in range(len(road.q)):
        if k != v and not road.blocked[v, k]:
            order[k] = arrival_time(query, road.q[v], start, road.q[k])
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
            _offer(query, road, heap, state, u * SPANS, depart, _UNKNOWN, bound)
        for j in range(road.number[u]):
            _offer(query, road, heap, state, u * SPANS + j, depart, ZERO, bound)


@inner_kernel
def _next_state(
    scene: MoverScene,
    query: Query,
    road: Roadmap,
    heap: Motions,
    checked: int,
    most: int,
    bound: float,
) -> tuple[int, int]:
    """Check queued motions, most promising first, until one of them is clear.

    Returns:
        The span of a vertex to which that leads, -1 for none; and ``checked`` and how many have
        been checked on the way, ``most`` in all.
    """
    step = scene.step
    first = int(np.floor(query.begin / step + 1e-6))
    while heap.size[0] > 0 and checked < most and heap.key[0] < bound - _TINY:
        depart, edge = heap.depart[0], heap.edge[0]
        source, target, tries = edge[0], edge[1], edge[2]
        pop_motion(heap)
        v, u, j = source // SPANS, target // SPANS, target % SPANS
        if road.blocked[v, u]:
            continue
        if tries == _UNKNOWN:
            if road.number[u] < 0:
                find_stands(scene, road, u, first)
            for k in range(road.number[u]):
                _offer(query, road, heap, source, u * SPANS + k, depart, ZERO, bound)
            continue
        if road.come[u, j] < np.inf:
            continue
        a, b = road.q[v], road.q[u]
        arrival = arrival_time(query, a, depart, b)
        checked += 1
        still, met = (
            is_clear_of_still_objects(scene, a, depart, b, arrival, 0.0),
            np.inf,
        )
        if still:
            met = first_conflict_time(scene, a, depart, b, arrival)
        if still and met == np.inf:
            road.come[u, j], road.left[u, j] = arrival, depart
            road.parent[u, j] = source
            return target, checked
        if tries == 0 and not still:
            road.blocked[v, u] = road.blocked[u, v] = True
        elif tries + 1 < _TRIES:
            later = np.floor(depart / step + 1e-6) * step + _LATER * (1 << tries)
            if met < np.inf:
                there = a + (met - depart) / (arrival - depart) * (b - a)
                until = earliest_free_time(scene, there, met, bound)
                later = max(later, depart + until - met)
            _offer(query, road, heap, source, target, later, tries + 1, bound)
    return -1, checked


@inner_kernel
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
    """Queue a motion if it may improve the result."""
    v, i = source // SPANS, source % SPANS
    u, j = target // SPANS, target % SPANS
    lo, hi = road.spans[u, j]
    arrival = arrival_time(query, road.q[v], depart, road.q[u])
    if arrival < lo:
        # As late as that it need not even leave.
        depart = depart + lo - arrival
        arrival = arrival_time(query, road.q[v], depart, road.q[u])
    if (
        depart > road.spans[v, i, 1] + _TINY
        or arrival > hi
        or arrival + road.rest[u] >= bound - _TINY
        or road.come[u, j] <= arrival
    ):
        return
    push_motion(heap, arrival + road.rest[u], depart, source, target, tries)


@inner_kernel
def _trace(road: Roadmap, last: int, best: float) -> tuple[Array, Array]:
    """Return the path to a safe interval of a vertex."""
    states = tree_branch(road.parent.reshape(-1), last)
    count = len(states)
    times, path = np.empty(2 * count), np.empty((2 * count, road.q.shape[1]))
    leave = best
    for c in range(count - 1, -1, -1):
        v, i = states[c] // SPANS, states[c] % SPANS
        times[2 * c], times[2 * c + 1] = road.come[v, i], leave
        copy_row(path[2 * c], road.q[v])
        copy_row(path[2 * c + 1], road.q[v])
        leave = road.left[v, i]
    return times, path
