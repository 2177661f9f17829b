"""Retiming of space-time paths: waits that lead to the earliest arrival, and waits as early as possible on the path.

Only the times of one robot change. Its path is checked against the planned motions of all other robots.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from planning.construction.checks.checker import SpaceTimeChecker
from planning.construction.checks.moving_checks import is_motion_clear
from planning.construction.checks.scene import MoverScene
from planning.construction.checks.time_windows import (
    mark_blocked_cells,
    write_free_spans,
)
from planning.construction.paths.query import (
    Query,
    SpaceTimePath,
    arrival_time,
    next_arrival,
)
from planning.kernels import inner_kernel, kernel
from planning.transforms import Array, Indices

_TINY = 1e-9
_SPANS = 16
"""Spans kept at one place."""

_SPACING = 0.5
"""Travel time between the places on a path at which waits are possible [s]."""


@kernel
def earliest_times_along(
    scene: MoverScene, query: Query, path: Array, goal: int, latest: float
) -> tuple[Array, Array]:
    """Return the earliest time of passing each waypoint of a path.

    Args:
        scene: what must be kept clear of.
        query: speeds, when joints are free to move, and windows of arrival.
        path: places, the first where the robot is, the last a goal, shape (w, n).
        goal: which goal that is.
        latest: only an arrival before this is of use [s].

    Returns:
        Times of coming, and of leaving, shape (w,); empty where there is no such arrival.
    """
    places = len(path)
    start, step = query.begin, scene.step
    spans, counts = _stands_along(scene, path, start, latest)
    # For each span of each place: arrival there, departure from the place before, and from
    # which span of it.
    come = np.full((places, _SPANS), np.inf)
    left = np.full((places, _SPANS), np.inf)
    before = np.full((places, _SPANS), -1, dtype=np.int64)
    come[0, 0] = start
    for k in range(places - 1):
        for i in range(counts[k]):
            depart = come[k, i]
            while depart <= spans[k, i, 1] + _TINY:
                arrival = arrival_time(query, path[k], depart, path[k + 1])
                if arrival >= latest:
                    break
                m = _span_at(spans[k + 1], counts[k + 1], arrival)
                if m >= 0:
                    if arrival < come[k + 1, m] - _TINY and is_motion_clear(
                        scene, path[k], depart, path[k + 1], arrival
                    ):
                        come[k + 1, m] = arrival
                        left[k + 1, m] = depart
                        before[k + 1, m] = i
                    if come[k + 1, m] < np.inf and m == counts[k + 1] - 1:
                        break
                depart = (np.floor(depart / step + 1e-6) + 1.0) * step
    best, last = latest, -1
    for i in range(counts[places - 1]):
        at = next_arrival(query, goal, come[places - 1, i])
        if at <= spans[places - 1, i, 1] + _TINY and at < best - _TINY:
            best, last = at, i
    if last < 0:
        return np.empty(0), np.empty(0)
    come_at, depart_at = np.empty(places), np.empty(places)
    depart_at[places - 1] = best
    i = last
    for k in range(places - 1, -1, -1):
        come_at[k] = come[k, i]
        if k > 0:
            depart_at[k - 1] = left[k, i]
            i = before[k, i]
    return come_at, depart_at


@kernel
def latest_times_along(
    scene: MoverScene, query: Query, path: Array, arrival: float
) -> tuple[Array, Array]:
    """Return the time of passing each waypoint of a path that leaves its start as late as possible.

    Args:
        scene: what must be kept clear of.
        query: speeds, and when the robot is free to move.
        path: places, the first where the robot is, the last a goal, shape (w, n).
        arrival: when it arrives [s].

    Returns:
        Arrival and departure times, shape (w,); empty where there is no feasible timing.
    """
    places = len(path)
    start, step = query.begin, scene.step
    spans, counts = _stands_along(scene, path, start, arrival)
    # For each span of each place: the latest departure that is still in time, and to which
    # span of the next place.
    leave = np.full((places, _SPANS), -np.inf)
    after = np.full((places, _SPANS), -1, dtype=np.int64)
    m = _span_at(spans[places - 1], counts[places - 1], arrival)
    if m < 0:
        return np.empty(0), np.empty(0)
    leave[places - 1, m] = arrival
    for k in range(places - 2, -1, -1):
        lasts = arrival_time(query, path[k], start, path[k + 1]) - start
        for m in range(counts[k + 1]):
            depart = leave[k + 1, m] - lasts
            while depart >= max(start, spans[k + 1, m, 0] - lasts) - _TINY:
                depart = max(depart, start)
                i = _span_at(spans[k], counts[k], depart)
                if i >= 0:
                    if depart > leave[k, i] + _TINY and is_motion_clear(
                        scene, path[k], depart, path[k + 1], depart + lasts
                    ):
                        leave[k, i] = depart
                        after[k, i] = m
                    if leave[k, i] > -np.inf and i == 0:
                        break
                depart = (np.ceil(depart / step - 1e-6) - 1.0) * step
    if leave[0, 0] == -np.inf:
        return np.empty(0), np.empty(0)
    come_at, leave_at = np.empty(places), np.empty(places)
    come_at[0], i = start, 0
    for k in range(places):
        leave_at[k] = leave[k, i]
        if k + 1 < places:
            come_at[k + 1] = leave_at[k] + (
                arrival_time(query, path[k], start, path[k + 1]) - start
            )
            i = after[k, i]
    return come_at, leave_at


@inner_kernel
def _stands_along(
    scene: MoverScene, path: Array, start: float, end: float
) -> tuple[Array, Indices]:
    """Return the time spans in which the robot may stand at each waypoint of a path.

    Args:
        scene: what must be kept clear of.
        path: places, shape (w, n); the robot is at the first one from ``start`` on.
        start, end: only collisions in between are checked [s].

    Returns:
        Spans of time, shape (w, _SPANS, 2) [s], and how many each place has, shape (w,).
    """
    step = scene.step
    first = int(np.floor(start / step + 1e-6))
    cells = max(int(np.ceil(end / step)) + 1 - first, 1)
    free = np.empty(cells, dtype=np.bool_)
    spans = np.empty((len(path), _SPANS, 2))
    counts = np.zeros(len(path), dtype=np.int64)
    for k in range(len(path)):
        free[:] = True
        mark_blocked_cells(scene, path[k], path[k], first, free)
        counts[k] = write_free_spans(free, first, step, spans[k])
    if counts[0] == 0 or spans[0, 0, 0] > start + _TINY:
        # It cannot stay where it is, and has to leave immediately.
        counts[0] = 1
        spans[0, 0] = start
    return spans, counts


@inner_kernel
def _span_at(spans: Array, count: int, t: float) -> int:
    """Return the span that contains a time, -1 for none."""
    for m in range(count):
        if spans[m, 0] - _TINY <= t <= spans[m, 1] + _TINY:
            return m
    return -1


def retime_with_waits(
    checker: SpaceTimeChecker, path: SpaceTimePath, query: Query, latest: float
) -> SpaceTimePath | None:
    """Return the path with the earliest arrival when waits on it are allowed, None where there is none.

    Args:
        checker: collision checker of the moving robot.
        path: a path whose times do not matter.
        query: speeds, when joints are free to move, and windows of arrival.
        latest: only an arrival before this is of use [s].
    """
    places = _places(path.path, query)
    if len(places) < 2:
        return None
    come, leave = earliest_times_along(checker.scene, query, places, path.goal, latest)
    if len(come) == 0:
        return None
    return _timed(path, places, come, leave)


def with_early_waits(
    checker: SpaceTimeChecker, found: SpaceTimePath, query: Query
) -> SpaceTimePath:
    """Return the path with its waits as early as possible and the same arrival, or unchanged.

    Args:
        checker: collision checker of one moving robot.
        found: a free path.
        query: speeds, and when the robot is free to move.
    """
    places = _places(found.path, query)
    if len(places) < 2:
        return found
    come, leave = latest_times_along(checker.scene, query, places, found.arrival)
    return found if len(come) == 0 else _timed(found, places, come, leave)


def _timed(
    planned: SpaceTimePath, places: Array, come: Array, leave: Array
) -> SpaceTimePath:
    """Return the path through waypoints, each with its arrival and departure time."""
    time = np.stack([come, leave], axis=1).ravel()
    path = np.repeat(places, 2, axis=0)
    keep = np.concatenate([[True], np.diff(time) > 1e-9])
    time, path = _without_waypoints(time[keep], path[keep])
    return replace(planned, time=time, path=path)


def _places(path: Array, query: Query) -> Array:
    """Return the distinct waypoints of a polyline, with more in between, at most _SPACING apart."""
    moves = np.any(np.abs(np.diff(path, axis=0)) > 1e-12, axis=1)
    path = path[np.concatenate([[True], moves])]
    travel = np.max(np.abs(np.diff(path, axis=0)) / query.velocity, axis=1)
    places = [path[:1]]
    for a, b, far in zip(path, path[1:], travel.tolist(), strict=False):
        count = max(int(np.ceil(far / _SPACING - 1e-9)), 0)
        share = np.arange(1, count)[:, None] / max(count, 1)
        places += [a + share * (b - a), np.tile(b, (min(count, 1), 1))]
    return np.concatenate(places)


def _without_waypoints(time: Array, path: Array) -> tuple[Array, Array]:
    """Remove waypoints on the straight space-time line between their neighbours."""
    kept = [0]
    for k in range(1, len(time) - 1):
        i = kept[-1]
        share = (time[k] - time[i]) / (time[k + 1] - time[i])
        on_line = path[i] + share * (path[k + 1] - path[i])
        if np.max(np.abs(on_line - path[k])) > 1e-9:
            kept.append(k)
    kept.append(len(time) - 1)
    return time[kept], path[kept]
