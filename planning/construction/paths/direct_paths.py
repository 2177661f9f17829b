"""Paths without a search: straight, or with the arm near HOME on the way, in compiled code.

While the base of a mobile robot drives, its arm may move towards HOME and back, if this does not delay the arrival.
The base may also wait for the arm at both ends. Waits are added to paths that are clear of static obstacles, so that
they avoid moving robots.
"""

from __future__ import annotations

import numpy as np

from planning.construction.checks.moving_checks import first_meeting_time
from planning.construction.checks.scene import MoverScene
from planning.construction.checks.still_checks import is_clear_of_still_objects
from planning.construction.paths.query import Query, next_arrival
from planning.kernels import argsort_few, inner_kernel, kernel
from planning.transforms import Array, Indices

_PLACES = 8
"""Greatest number of waypoints of a path."""


@kernel
def direct_paths(
    scene: MoverScene, query: Query, latest: float, most: int, shares: int
) -> tuple[Array, Array, Indices, Indices, bool]:
    """Find paths that are clear of static obstacles, earliest arrivals first.

    Args:
        scene: the robot and its obstacles.
        query: the query.
        latest: latest arrival of the paths [s].
        most: greatest number of paths; the first one that is clear of everything ends the search.
        shares: of the arm's time for which a robot may stand, from none to all of it; 0 for
            straight paths only.

    Returns:
        Times and waypoints, shapes (k, w) and (k, w, n); how many waypoints each has; its
        goal; and whether the last one is clear of everything.
    """
    n, goals = len(query.start), len(query.goals)
    kinds = 1 + shares * shares
    soon = np.empty(goals * kinds)
    for g in range(goals):
        for k in range(kinds):
            soon[g * kinds + k] = next_arrival(
                query, g, _earliest_arrival(query, g, k, shares)
            )
    times, paths = np.empty((most, _PLACES)), np.empty((most, _PLACES, n))
    counts = np.zeros(most, dtype=np.int64)
    which = np.zeros(most, dtype=np.int64)
    found = 0
    order = argsort_few(soon)
    for c in range(len(order)):
        g, k = order[c] // kinds, order[c] % kinds
        if found == most or soon[order[c]] > latest:
            break
        counts[found] = _lay(
            query, g, k, shares, soon[order[c]], times[found], paths[found]
        )
        if not _still_clear(scene, times[found], paths[found], counts[found]):
            continue
        which[found] = g
        found += 1
        if _is_clear_of_robots(
            scene, times[found - 1], paths[found - 1], counts[found - 1]
        ):
            return times[:found], paths[:found], counts[:found], which[:found], True
    return times[:found], paths[:found], counts[:found], which[:found], False


@inner_kernel
def _stands(
    query: Query, goal: int, kind: int, shares: int
) -> tuple[float, float, float, float]:
    """Return the durations of the detour towards HOME for some joints, and of the wait of the others [s]."""
    if kind == 0:
        return 0.0, 0.0, 0.0, 0.0
    lean, back = 0.0, 0.0
    for j in range(len(query.start)):
        if query.leans[j]:
            v, rest = query.velocity[j], query.rest[j]
            lean = max(lean, abs(rest - query.start[j]) / v)
            back = max(back, abs(rest - query.goals[goal, j]) / v)
    a, b = (kind - 1) // shares, (kind - 1) % shares
    return lean, back, lean * a / max(shares - 1, 1), back * b / max(shares - 1, 1)


@inner_kernel
def _earliest_arrival(query: Query, goal: int, kind: int, shares: int) -> float:
    """Return the earliest possible arrival of a path [s]."""
    _, _, before, after = _stands(query, goal, kind, shares)
    start = query.begin
    out = start
    for j in range(len(query.start)):
        travel = abs(query.goals[goal, j] - query.start[j]) / query.velocity[j]
        if query.leans[j]:
            out = max(out, start + travel)
        elif travel > 0.0:
            out = max(out, start + before + travel + after)
    return out


@inner_kernel
def _lay(
    query: Query,
    goal: int,
    kind: int,
    shares: int,
    arrival: float,
    times: Array,
    path: Array,
) -> int:
    """Write a path that arrives at a given time; return its number of waypoints."""
    lean, back, before, after = _stands(query, goal, kind, shares)
    start = query.begin
    span = arrival - start
    if lean + back > span > 0.0:
        share = span / (lean + back)
        lean, back = lean * share, back * share
    marks = np.empty(6)
    marks[0], marks[1], marks[2] = start, start + before, start + lean
    marks[3], marks[4], marks[5] = arrival - back, arrival - after, arrival
    count = 0
    for m in argsort_few(marks):
        t = min(max(marks[m], start), arrival)
        if count > 0 and t < times[count - 1] + 1e-6 and t < arrival:
            continue
        if count > 1 and t < times[count - 1] + 1e-6:
            count -= 1
        times[count] = t
        for j in range(path.shape[1]):
            path[count, j] = _at(
                query, goal, kind, j, t, before, arrival - after, arrival
            )
        count += 1
    return count


@inner_kernel
def _at(
    query: Query,
    goal: int,
    kind: int,
    j: int,
    t: float,
    leave: float,
    come: float,
    arrival: float,
) -> float:
    """Return the value of a joint at a time: towards HOME as far as speeds allow, or straight."""
    a, b, v = float(query.start[j]), float(query.goals[goal, j]), query.velocity[j]
    start = query.begin
    if t >= arrival:
        return b
    if kind > 0 and query.leans[j]:
        ahead, left = v * (t - start), v * (arrival - t)
        low, high = max(a - ahead, b - left), min(a + ahead, b + left)
        return float(min(max(query.rest[j], low), high))
    begin = start + leave
    if t <= begin:
        return a
    if t >= come:
        return b
    return float(a + (b - a) * (t - begin) / (come - begin))


@inner_kernel
def _still_clear(scene: MoverScene, times: Array, path: Array, count: int) -> bool:
    """Tell whether a path is clear of static obstacles: samples first, then all of it."""
    middle = np.empty(path.shape[1])
    for k in range(count - 1, 0, -1):
        t = times[k]
        if not is_clear_of_still_objects(scene, path[k], t, path[k], t, 0.0):
            return False
    for k in range(count - 1):
        t = 0.5 * (times[k] + times[k + 1])
        for j in range(len(middle)):
            middle[j] = 0.5 * (path[k, j] + path[k + 1, j])
        if not is_clear_of_still_objects(scene, middle, t, middle, t, 0.0):
            return False
    for k in range(count - 1):
        a, s, b, t = path[k], times[k], path[k + 1], times[k + 1]
        if not is_clear_of_still_objects(scene, a, s, b, t, 0.0):
            return False
    return True


@inner_kernel
def _is_clear_of_robots(
    scene: MoverScene, times: Array, path: Array, count: int
) -> bool:
    """Tell whether a path is clear of moving robots."""
    for k in range(count - 1):
        a, s, b, t = path[k], times[k], path[k + 1], times[k + 1]
        if first_meeting_time(scene, a, s, b, t) < np.inf:
            return False
    return True
