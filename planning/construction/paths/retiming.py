"""Retiming of a given path, compiled: when to wait where, at full speed otherwise.

Places on the path are fixed; only time is searched, over the spans of time in which the movers
may stand at each place. What comes out is the earliest arrival for departures on a fine grid.
"""

from __future__ import annotations

import numpy as np

from planning.construction.checks.motion_checks import motion_clear
from planning.construction.checks.scene import Scene
from planning.construction.checks.time_windows import spans_of, strike_out
from planning.construction.paths.query import Query, arrive, next_arrival
from planning.kernels import inner_kernel, kernel
from planning.transforms import Array, Indices

_TINY = 1e-9
_SPANS = 16
"""Spans kept at one place."""


@kernel
def earliest_along(
    scene: Scene, query: Query, path: Array, goal: int, latest: float
) -> tuple[Array, Array]:
    """Return the times at each place of a path with which it is passed as early as possible.

    Args:
        scene: what must be kept clear of.
        query: speeds, when joints are free to move, and windows of arrival.
        path: places, the first where the movers are, the last a goal, shape (w, n).
        goal: which goal that is.
        latest: only an arrival before this is of use [s].

    Returns:
        Times of coming, and of leaving, shape (w,); empty where there is no such arrival.
    """
    places = len(path)
    start, step = np.min(query.begin), scene.step
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
                arrival = arrive(query, path[k], depart, path[k + 1])
                if arrival >= latest:
                    break
                m = _span_at(spans[k + 1], counts[k + 1], arrival)
                if m >= 0:
                    if arrival < come[k + 1, m] - _TINY and motion_clear(
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
def latest_along(
    scene: Scene, query: Query, path: Array, arrival: float
) -> tuple[Array, Array]:
    """Return the times at each place of a path with which its start is left as late as possible.

    Args:
        scene: what must be kept clear of.
        query: speeds, and when the one mover is free to move.
        path: places, the first where the mover is, the last a goal, shape (w, n).
        arrival: when it arrives [s].

    Returns:
        Times of coming, and of leaving, shape (w,); empty where there is no way to be there then.
    """
    places = len(path)
    start, step = np.min(query.begin), scene.step
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
        lasts = arrive(query, path[k], start, path[k + 1]) - start
        for m in range(counts[k + 1]):
            depart = leave[k + 1, m] - lasts
            while depart >= max(start, spans[k + 1, m, 0] - lasts) - _TINY:
                depart = max(depart, start)
                i = _span_at(spans[k], counts[k], depart)
                if i >= 0:
                    if depart > leave[k, i] + _TINY and motion_clear(
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
                arrive(query, path[k], start, path[k + 1]) - start
            )
            i = after[k, i]
    return come_at, leave_at


@inner_kernel
def _stands_along(
    scene: Scene, path: Array, start: float, end: float
) -> tuple[Array, Indices]:
    """Return the spans of time in which the movers may stand at each place of a path.

    Args:
        scene: what must be kept clear of.
        path: places, shape (w, n); the movers are at the first one from ``start`` on.
        start, end: what is before or after is not looked at [s].

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
        strike_out(scene, path[k], path[k], first, free)
        counts[k] = spans_of(free, first, step, spans[k])
    if counts[0] == 0 or spans[0, 0, 0] > start + _TINY:
        # It cannot stay where it is, and has to leave at once.
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
