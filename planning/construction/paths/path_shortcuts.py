"""Shortcuts of space-time paths: less joint travel between the same start and end (Hartmann et al. IV-C).

Only the path of one robot changes. It is checked against the planned motions of all other robots.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from planning.construction.checks.checker import SpaceTimeChecker
from planning.construction.checks.moving_checks import is_motion_clear
from planning.construction.checks.scene import MoverScene
from planning.construction.paths.query import Query, SpaceTimePath
from planning.kernels import copy_row, inner_kernel, kernel
from planning.transforms import Array

_GAIN = 1e-6


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
