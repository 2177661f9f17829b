"""Paths that need no search, compiled: straight ones, and ones that lean towards HOME.

While a robot drives, its arm has time to spare: on the way it may come as near to the posture
of HOME as speeds allow and still arrive as soon. It may also stand until its arm is up, or
until its arm is down again. What is free of everything that lies still is retimed by waits.

Queries in space-time and the paths that answer them; bounds and random samples, compiled.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from planning.construction.checks.moving_checks import first_meeting
from planning.construction.checks.scene import MoverScene
from planning.construction.checks.still_checks import still_clear
from planning.kernels import inner_kernel, kernel, order_of_few
from planning.transforms import Array, Indices

_TINY = 1e-9


class Query(NamedTuple):
    """A query: from a start to one of several goals within their time windows.

    Attributes:
        start: where the robot is, shape (n,).
        begin: when it is free to move [s].
        lower, upper, velocity: of the joints, shape (n,).
        goals: configurations any of which will do, shape (g, n).
        window_first: windows of goal k are ``range(window_first[k], window_first[k + 1])``.
        windows: spans of time of arrival, in order, shape (w, 2) [s].
        rest: posture of HOME, shape (n,).
        leans: True for joints that keep to that posture where they have time for it, False for
            those that drive, shape (n,).
    """

    start: Array
    begin: float
    lower: Array
    upper: Array
    velocity: Array
    goals: Array
    window_first: Indices
    windows: Array
    rest: Array
    leans: npt.NDArray[np.bool_]


@dataclass(frozen=True)
class SpaceTimePath:
    """A collision-free path through space-time.

    Attributes:
        time: of the waypoints, rising, shape (w,) [s].
        path: waypoints, straight in between, shape (w, n).
        goal: which goal it leads to.
        earliest: no path to any goal arrives before [s].
    """

    time: Array
    path: Array
    goal: int
    earliest: float

    @property
    def arrival(self) -> float:
        """Arrival time [s]."""
        return float(self.time[-1])


@kernel
def arrive(query: Query, a: Array, t: float, b: Array) -> float:
    """Return the arrival at ``b`` after a departure from ``a`` at time ``t``, obstacles aside [s]."""
    out = t
    for j in range(len(a)):
        travel = abs(b[j] - a[j])
        if travel > 0.0:
            out = max(out, t + travel / query.velocity[j])
    return out


@kernel
def next_arrival(query: Query, goal: int, t: float) -> float:
    """Return the first time from ``t`` on that is in a window of a goal, infinity for none [s]."""
    for w in range(query.window_first[goal], query.window_first[goal + 1]):
        if query.windows[w, 1] >= t - _TINY:
            first: float = query.windows[w, 0]
            return max(t, first)
    return np.inf


@inner_kernel
def chain_to(parent: Indices, last: int) -> Indices:
    """Return the nodes of a tree from its root to one of them; a root's parent is below 0."""
    count, at = 1, last
    while parent[at] >= 0:
        count, at = count + 1, parent[at]
    out = np.empty(count, dtype=np.int64)
    at = last
    for c in range(count - 1, -1, -1):
        out[c] = at
        at = parent[at]
    return out


@inner_kernel
def random_share(state: npt.NDArray[np.uint64]) -> float:
    """Return the next random number in [0, 1): splitmix64, so that a seed means one sequence."""
    state[0] += np.uint64(0x9E3779B97F4A7C15)
    z = state[0]
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    share: float = np.float64(z >> np.uint64(11)) / 9007199254740992.0
    return share


@inner_kernel
def random_normal(state: npt.NDArray[np.uint64]) -> float:
    """Return a random number that is nearly normal: the sum of a few uniform ones."""
    total = -3.0
    for _ in range(6):
        total += random_share(state)
    return 1.4142 * total


@inner_kernel
def sample_between(
    query: Query,
    goal: int,
    arrival: float,
    state: npt.NDArray[np.uint64],
    out: Array,
) -> float:
    """Draw a place in space-time that can be reached and from which a goal can be; return its time."""
    t = query.begin + random_share(state) * (arrival - query.begin)
    # While a robot drives its arm had better keep out of the way.
    leaning = random_share(state) < 0.5 and not np.all(query.leans)
    for j in range(len(out)):
        v = query.velocity[j]
        ahead, left = v * (t - query.begin), v * (arrival - t)
        low = max(query.lower[j], query.start[j] - ahead)
        high = min(query.upper[j], query.start[j] + ahead)
        low = max(low, query.goals[goal, j] - left)
        high = min(high, query.goals[goal, j] + left)
        share = random_share(state)
        out[j] = 0.5 * (low + high) if high <= low else low + share * (high - low)
        if leaning and query.leans[j] and high > low:
            out[j] = min(max(query.rest[j], low), high)
        if ahead == 0.0:
            out[j] = query.start[j]
    return float(t)


_PLACES = 8
"""Waypoints of a way, at most."""


@kernel
def direct_paths(
    scene: MoverScene, query: Query, latest: float, most: int, shares: int
) -> tuple[Array, Array, Indices, Indices, bool]:
    """Look for ways that are clear of all that lies still, the earliest arrivals first.

    Args:
        scene: what must be kept clear of.
        query: what is asked for.
        latest: no later arrival is looked at [s].
        most: ways wanted; the first that is clear of everything is the last one.
        shares: of the arm's time for which a robot may stand, from none to all of it; 0 for
            straight ways only.

    Returns:
        Times and waypoints, shapes (k, w) and (k, w, n); how many waypoints each has; its
        goal; and whether the last one is clear of everything.
    """
    n, goals = len(query.start), len(query.goals)
    kinds = 1 + shares * shares
    soon = np.empty(goals * kinds)
    for g in range(goals):
        for k in range(kinds):
            soon[g * kinds + k] = next_arrival(query, g, _soonest(query, g, k, shares))
    times, ways = np.empty((most, _PLACES)), np.empty((most, _PLACES, n))
    counts = np.zeros(most, dtype=np.int64)
    which = np.zeros(most, dtype=np.int64)
    found = 0
    order = order_of_few(soon)
    for c in range(len(order)):
        g, k = order[c] // kinds, order[c] % kinds
        if found == most or soon[order[c]] > latest:
            break
        counts[found] = _lay(
            query, g, k, shares, soon[order[c]], times[found], ways[found]
        )
        if not _still_clear(scene, times[found], ways[found], counts[found]):
            continue
        which[found] = g
        found += 1
        if _meets_nobody(scene, times[found - 1], ways[found - 1], counts[found - 1]):
            return times[:found], ways[:found], counts[:found], which[:found], True
    return times[:found], ways[:found], counts[:found], which[:found], False


@inner_kernel
def _stands(
    query: Query, goal: int, kind: int, shares: int
) -> tuple[float, float, float, float]:
    """Return for how long joints lean and come back, and for how long the others stand [s]."""
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
def _soonest(query: Query, goal: int, kind: int, shares: int) -> float:
    """Return how soon a way can arrive [s]."""
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
    way: Array,
) -> int:
    """Write a way that arrives at a time; return how many waypoints it has."""
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
    for m in order_of_few(marks):
        t = min(max(marks[m], start), arrival)
        if count > 0 and t < times[count - 1] + 1e-6 and t < arrival:
            continue
        if count > 1 and t < times[count - 1] + 1e-6:
            count -= 1
        times[count] = t
        for j in range(way.shape[1]):
            way[count, j] = _at(
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
    """Return where a joint is at a time: leaning as far as speeds allow, or going straight."""
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
def _still_clear(scene: MoverScene, times: Array, way: Array, count: int) -> bool:
    """Tell whether a way is clear of all that lies still: places on it first, then all of it."""
    middle = np.empty(way.shape[1])
    for k in range(count - 1, 0, -1):
        t = times[k]
        if not still_clear(scene, way[k], t, way[k], t, 0.0):
            return False
    for k in range(count - 1):
        t = 0.5 * (times[k] + times[k + 1])
        for j in range(len(middle)):
            middle[j] = 0.5 * (way[k, j] + way[k + 1, j])
        if not still_clear(scene, middle, t, middle, t, 0.0):
            return False
    for k in range(count - 1):
        a, s, b, t = way[k], times[k], way[k + 1], times[k + 1]
        if not still_clear(scene, a, s, b, t, 0.0):
            return False
    return True


@inner_kernel
def _meets_nobody(scene: MoverScene, times: Array, way: Array, count: int) -> bool:
    """Tell whether a way is clear of robots that move."""
    for k in range(count - 1):
        a, s, b, t = way[k], times[k], way[k + 1], times[k + 1]
        if first_meeting(scene, a, s, b, t) < np.inf:
            return False
    return True
