"""Post-processing of paths through space-time: shorter, earlier, smoother (Hartmann et al. IV-C).

Only the robot's own motion changes, checked against the fixed timelines. No step makes the arrival later.
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
from planning.kernels import copy_row, inner_kernel, kernel
from planning.transforms import Array, Indices

_TINY = 1e-9
_SPANS = 16
"""Spans kept at one place."""

_GAIN = 1e-6
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


def shortcut_path(
    checker: SpaceTimeChecker,
    found: SpaceTimePath,
    query: Query,
    tries: int,
    seed: int,
) -> SpaceTimePath:
    """Return a path with the same ends and times and less joint travel.

    Stretches are replaced by straight lines in space-time, for all joints or for one.

    Args:
        checker: collision checker of the moving robot.
        found: a free path.
        query: speeds, and when joints are free to move.
        tries: number of random stretches.
        seed: of the random numbers.
    """
    rng, scene = np.random.default_rng([seed, 17]), checker.scene
    time, path = _without_corners(scene, query, found.time, found.path)
    begin, end = float(time[0]), float(time[-1])
    for attempt in range(tries):
        if len(time) < 3:
            break
        lo, hi = sorted(rng.uniform(begin, end, 2).tolist())
        if hi - lo < 1e-3 or not np.any((time >= lo) & (time < hi)):
            continue
        joint = int(rng.integers(path.shape[1])) if attempt % 3 == 2 else -1
        time, path = _shortcut(scene, query, time, path, lo, hi, joint)
    time, path = _without_corners(scene, query, time, path)
    return replace(found, time=time, path=path)


@kernel
def _shortcut(
    scene: MoverScene,
    query: Query,
    time: Array,
    path: Array,
    lo: float,
    hi: float,
    joint: int,
) -> tuple[Array, Array]:
    """Return the path made straight between two times, unchanged where that is longer or not free.

    Args:
        scene: what must be kept clear of.
        query: speeds.
        time, path: of the waypoints, shapes (w,) and (w, n).
        lo, hi: the times; a waypoint lies between [s].
        joint: the only one that goes straight, -1 for all.
    """
    i, j = np.searchsorted(time, lo), np.searchsorted(time, hi)
    n, inner = path.shape[1], j - i
    old, when = np.empty((inner + 2, n)), np.empty(inner + 2)
    when[0], when[-1] = lo, hi
    copy_row(when[1:-1], time[i:j])
    copy_row(old[0], _point(time, path, lo))
    copy_row(old[-1], _point(time, path, hi))
    for k in range(inner):
        copy_row(old[k + 1], path[i + k])
    bridge = old.copy()
    if joint < 0:
        bridge, when = np.empty((2, n)), np.empty(2)
        when[0], when[1] = lo, hi
        copy_row(bridge[0], old[0])
        copy_row(bridge[1], old[-1])
    else:
        a, b = old[0, joint], old[-1, joint]
        for k in range(len(when)):
            share = (when[k] - lo) / (hi - lo)
            bridge[k, joint] = a + share * (b - a)
    if _length(bridge, query) > _length(old, query) - _GAIN:
        return time, path
    for k in range(len(when) - 1):
        if not _possible(query, bridge[k], when[k], bridge[k + 1], when[k + 1]):
            return time, path
    for k in range(len(when) - 1):
        if not is_motion_clear(scene, bridge[k], when[k], bridge[k + 1], when[k + 1]):
            return time, path
    return _merged(
        np.concatenate((time[:i], when, time[j:])),
        np.concatenate((path[:i], bridge, path[j:])),
    )


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


@inner_kernel
def _point(time: Array, path: Array, t: float) -> Array:
    """Return the configuration of the path at a time."""
    after = int(np.searchsorted(time, t, side="right"))
    k = min(max(after - 1, 0), len(time) - 2)
    span = max(time[k + 1] - time[k], 1e-300)
    share = min(max((t - time[k]) / span, 0.0), 1.0)
    return np.asarray(path[k] + share * (path[k + 1] - path[k]))


@inner_kernel
def _length(path: Array, query: Query) -> float:
    """Return the travel time of a polyline, with a little of every joint's travel [s]."""
    slowest, total = 0.0, 0.0
    for k in range(len(path) - 1):
        most = 0.0
        for j in range(path.shape[1]):
            travel = abs(path[k + 1, j] - path[k, j]) / query.velocity[j]
            most, total = max(most, travel), total + travel
        slowest += most
    return slowest + 0.1 * total


@inner_kernel
def _possible(query: Query, a: Array, s: float, b: Array, t: float) -> bool:
    """Tell whether the speed limits allow a motion between two timed configurations."""
    for j in range(len(a)):
        travel = abs(b[j] - a[j]) / query.velocity[j]
        if travel > t - s + 1e-9 and travel >= 1e-12:
            return False
    return True


@kernel
def _without_corners(
    scene: MoverScene, query: Query, time: Array, path: Array
) -> tuple[Array, Array]:
    """Remove waypoints, longest stretches first, where the shortcut is free and within speed limits."""
    keep = np.zeros(len(time), dtype=np.bool_)
    keep[0] = True
    ends = np.empty((2, path.shape[1]))
    i = 0
    while i < len(time) - 1:
        j = len(time) - 1
        while j > i + 1:
            copy_row(ends[0], path[i])
            copy_row(ends[1], path[j])
            if (
                _length(ends, query) <= _length(path[i : j + 1], query) + _GAIN
                and _possible(query, path[i], time[i], path[j], time[j])
                and is_motion_clear(scene, path[i], time[i], path[j], time[j])
            ):
                break
            j -= 1
        keep[j] = True
        i = j
    return time[keep], path[keep]


@inner_kernel
def _merged(time: Array, path: Array) -> tuple[Array, Array]:
    """Remove waypoints at the same time as the one before, except the last one."""
    keep = np.ones(len(time), dtype=np.bool_)
    for k in range(1, len(time)):
        keep[k] = time[k] - time[k - 1] > 1e-9
    if len(time) > 1 and not keep[-1]:
        keep[-1], keep[-2] = True, len(time) == 2
    return time[keep], path[keep]


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
