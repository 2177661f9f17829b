"""The loop of the bi-directional space-time RRT, compiled (Hartmann et al. IV-C).

Two forests grow in space-time: one from where the movers are, forwards in time, and one from
goals at sampled arrival times, backwards. A motion from (q, t) to (q', t') is possible where
t < t' and no joint must go faster than it can; its length is eq. (5), with the time that the
slowest joint needs as the distance of configurations.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from planning.construction.arena import Arena, Integers
from planning.construction.space_time_kernel import motion_clear
from planning.transforms import Array

_TINY = 1e-9


class Query(NamedTuple):
    """What is asked for.

    Attributes:
        start: where the movers are, shape (n,).
        begin: when each joint is free to move, shape (n,) [s].
        lower, upper, velocity: of the joints, shape (n,).
        goals: configurations any of which will do, shape (g, n).
        window_first: windows of goal k are ``range(window_first[k], window_first[k + 1])``.
        windows: spans of time in which one may arrive, in order, shape (w, 2) [s].
        rest: posture of HOME, shape (n,).
        leans: True for joints that keep to that posture where they have time for it, False for
            those that drive, shape (n,).
    """

    start: Array
    begin: Array
    lower: Array
    upper: Array
    velocity: Array
    goals: Array
    window_first: Integers
    windows: Array
    rest: Array
    leans: npt.NDArray[np.bool_]


class Limits(NamedTuple):
    """How the search goes on.

    Attributes:
        iterations: samples in all.
        patience: samples after the last improvement.
        weight: lambda of eq. (5).
        reach: longest motion added at once [s].
        growth: factor by which the range of arrival times grows.
        gain: least improvement of the arrival time that counts [s].
        latest: no later arrival is asked for [s].
        seed: of all random numbers.
    """

    iterations: int
    patience: int
    weight: float
    reach: float
    growth: float
    gain: float
    latest: float
    seed: int


@njit(cache=True, nogil=True)
def random_share(state: npt.NDArray[np.uint64]) -> float:
    """Return the next random number in [0, 1): splitmix64, so that a seed means one sequence."""
    state[0] += np.uint64(0x9E3779B97F4A7C15)
    z = state[0]
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    share: float = np.float64(z >> np.uint64(11)) / 9007199254740992.0
    return share


@njit(cache=True, nogil=True)
def least_time(query: Query, q: Array, t: float, goal: int) -> float:
    """Return how soon the goal can be reached from (q, t), obstacles aside [s]."""
    out = t
    for j in range(len(q)):
        travel = abs(query.goals[goal, j] - q[j])
        if travel > 0.0:
            out = max(out, max(t, query.begin[j]) + travel / query.velocity[j])
    return out


@njit(cache=True, nogil=True)
def next_arrival(query: Query, goal: int, t: float) -> float:
    """Return the first time from ``t`` on at which one may arrive at a goal, inf for none."""
    for w in range(query.window_first[goal], query.window_first[goal + 1]):
        if query.windows[w, 1] >= t - _TINY:
            first: float = query.windows[w, 0]
            return max(t, first)
    return np.inf


@njit(cache=True, nogil=True)
def _distance(
    query: Query, a: Array, ta: float, b: Array, tb: float, weight: float
) -> float:
    """Return eq. (5) from (a, ta) to (b, tb), inf where a joint would have to go too fast."""
    if tb <= ta + _TINY:
        return np.inf
    far = 0.0
    for j in range(len(a)):
        travel = abs(b[j] - a[j]) / query.velocity[j]
        if travel > _TINY and travel > tb - max(ta, query.begin[j]) + _TINY:
            return np.inf
        far = max(far, travel)
    return weight * far + (1.0 - weight) * (tb - ta)


@njit(cache=True, nogil=True)
def _point(
    query: Query, a: Array, ta: float, b: Array, tb: float, t: float, out: Array
) -> None:
    """Write where the motion from (a, ta) to (b, tb) is at a time."""
    for j in range(len(a)):
        begin = max(ta, query.begin[j])
        share = 0.0
        if t >= tb:
            share = 1.0
        elif t > begin:
            share = (t - begin) / (tb - begin)
        out[j] = b[j] if share == 1.0 else a[j] + share * (b[j] - a[j])


class Forest(NamedTuple):
    """Nodes in space-time.

    Attributes:
        q: shape (most, n).
        t: shape (most,) [s].
        parent: towards the root, -1 for a root, shape (most,).
        root: its root's node, shape (most,).
        goal: goal of a root, shape (most,).
    """

    q: Array
    t: Array
    parent: Integers
    root: Integers
    goal: Integers


@njit(cache=True, nogil=True)
def _new_forest(most: int, n: int) -> Forest:
    return Forest(
        np.empty((most, n)),
        np.empty(most),
        np.empty(most, dtype=np.int64),
        np.empty(most, dtype=np.int64),
        np.empty(most, dtype=np.int64),
    )


@njit(cache=True, nogil=True)
def _add(forest: Forest, count: int, q: Array, t: float, parent: int, goal: int) -> int:
    """Add a node; return the new count."""
    forest.q[count] = q
    forest.t[count] = t
    forest.parent[count] = parent
    forest.root[count] = forest.root[parent] if parent >= 0 else count
    forest.goal[count] = goal
    return count + 1


@njit(cache=True, nogil=True)
def _nearest(
    query: Query,
    forest: Forest,
    count: int,
    q: Array,
    t: float,
    forward: bool,
    weight: float,
    bound: float,
) -> int:
    """Return the node from which (forward) or to which (q, t) is nearest, -1 for none.

    Nodes of goals that are too late are left out.
    """
    best, at = np.inf, -1
    for k in range(count):
        if forward:
            if forest.t[k] >= t:
                continue
            d = _distance(query, forest.q[k], forest.t[k], q, t, weight)
        else:
            if forest.t[k] <= t or forest.t[forest.root[k]] > bound:
                continue
            d = _distance(query, q, t, forest.q[k], forest.t[k], weight)
        if d < best:
            best, at = d, k
    return at


@njit(cache=True, nogil=True)
def _extend(
    scene: Arena,
    query: Query,
    forest: Forest,
    count: int,
    near: int,
    q: Array,
    t: float,
    forward: bool,
    reach: float,
    out: Array,
) -> tuple[bool, float]:
    """Go from a node towards (q, t), half as far where that is blocked.

    Returns:
        Whether something of it is free, and the time of its end, whose configuration is
        written to ``out``.
    """
    tn = forest.t[near]
    span = min(abs(t - tn), reach)
    for _ in range(3):
        if forward:
            end = t if span >= t - tn - _TINY else tn + span
            _point(query, forest.q[near], tn, q, t, end, out)
            if motion_clear(scene, forest.q[near], tn, out, end):
                return True, end
        else:
            end = t if span >= tn - t - _TINY else tn - span
            _point(query, q, t, forest.q[near], tn, end, out)
            if motion_clear(scene, out, end, forest.q[near], tn):
                return True, end
        span *= 0.4
        if span < 0.02:
            break
    return False, tn


@njit(cache=True, nogil=True)
def sample_between(
    query: Query,
    goal: int,
    arrival: float,
    state: npt.NDArray[np.uint64],
    out: Array,
) -> float:
    """Draw a place in space-time that can be reached and from which a goal can be; return its time."""
    first = np.inf
    for j in range(len(out)):
        first = min(first, query.begin[j])
    t = first + random_share(state) * (arrival - first)
    # While a robot drives its arm had better keep out of the way.
    leaning = random_share(state) < 0.5 and not np.all(query.leans)
    for j in range(len(out)):
        v = query.velocity[j]
        ahead = v * max(t - query.begin[j], 0.0)
        left = v * (arrival - max(t, query.begin[j]))
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
    return t


@njit(cache=True, nogil=True)
def grow(
    scene: Arena, query: Query, limits: Limits, bound: float
) -> tuple[Array, Array, int, int, int]:
    """Grow both forests, and go on to arrive earlier once they have met.

    Args:
        scene: what must be kept clear of.
        query: what is asked for.
        limits: how long.
        bound: only an arrival before this is of use [s].

    Returns:
        Times and configurations of the best path found, shapes (w,) and (w, n), empty where
        there is none; its goal; samples drawn; and goals added.
    """
    n = len(query.start)
    most = 3 * limits.iterations + 16
    ahead, back = _new_forest(most, n), _new_forest(most, n)
    state = np.zeros(1, dtype=np.uint64)
    state[0] = np.uint64(limits.seed)
    start = np.min(query.begin)
    soonest = np.inf
    for goal in range(len(query.goals)):
        reach = least_time(query, query.start, start, goal)
        soonest = min(soonest, next_arrival(query, goal, reach))
    times, path = np.empty(0), np.empty((0, n))
    found = -1
    if soonest == np.inf or soonest > limits.latest or soonest > bound - limits.gain:
        return times, path, found, 0, 0
    bound = min(bound - limits.gain, limits.latest)
    number = _add(ahead, 0, query.start, start, -1, -1)
    roots = 0
    behind = 0
    horizon = soonest + max(0.25 * (soonest - start), 1.0)
    q, new, other = np.empty(n), np.empty(n), np.empty(n)
    since, drawn = 0, 0
    forward = True
    for _ in range(limits.iterations):
        if found >= 0 and since >= limits.patience:
            break
        drawn += 1
        since += 1
        top = min(horizon, bound)
        # Goals at ever later times: with one sample in eight, and until there are a few.
        if (roots < 4 or random_share(state) < 0.12) and behind < most - 4:
            goal = int(random_share(state) * len(query.goals))
            first = least_time(query, query.start, start, goal)
            share = random_share(state)
            at = first + (max(top, first) - first) * share * share
            at = next_arrival(query, goal, at)
            if at <= bound and at - first < 1e9:
                behind = _add(back, behind, query.goals[goal], at, -1, goal)
                roots += 1
            if roots >= 4 or drawn > 40:
                horizon = start + (horizon - start) * limits.growth
                horizon = min(horizon, limits.latest)
            if behind == 0:
                continue
        if behind == 0:
            continue
        # A goal that is early enough still.
        pick = int(random_share(state) * behind)
        root = back.root[pick]
        if back.t[root] > bound:
            root = -1
            for k in range(behind):
                r = back.root[(pick + k) % behind]
                if back.t[r] <= bound:
                    root = r
                    break
            if root < 0:
                roots = 0
                continue
        t = sample_between(query, back.goal[root], back.t[root], state, q)
        tree, size = (ahead, number) if forward else (back, behind)
        near = _nearest(query, tree, size, q, t, forward, limits.weight, bound)
        if near >= 0 and size < most - 4:
            ok, end = _extend(
                scene, query, tree, size, near, q, t, forward, limits.reach, new
            )
            if ok:
                goal = tree.goal[near]
                at_node = size
                if forward:
                    number = _add(ahead, number, new, end, near, goal)
                else:
                    behind = _add(back, behind, new, end, near, goal)
                # Let the other forest come to the new node.
                tree, size = (back, behind) if forward else (ahead, number)
                near = _nearest(
                    query, tree, size, new, end, not forward, limits.weight, bound
                )
                if near >= 0:
                    ok, last = _extend(
                        scene,
                        query,
                        tree,
                        size,
                        near,
                        new,
                        end,
                        not forward,
                        1e9,
                        other,
                    )
                    if ok and abs(last - end) <= _TINY:
                        a, b = (at_node, near) if forward else (near, at_node)
                        times, path, found = _join(ahead, a, back, b)
                        times, path = _hurry(scene, query, times, path, found)
                        bound = times[-1] - limits.gain
                        since = 0
                        roots = 0
                        if soonest > bound:
                            break
                    elif ok and size < most - 4:
                        goal = tree.goal[near]
                        if forward:
                            behind = _add(back, behind, other, last, near, goal)
                        else:
                            number = _add(ahead, number, other, last, near, goal)
        forward = not forward
    return times, path, found, drawn, behind


@njit(cache=True, nogil=True)
def _join(ahead: Forest, a: int, back: Forest, b: int) -> tuple[Array, Array, int]:
    """Return times and configurations from the start through two nodes to a goal."""
    count = 0
    k = a
    while k >= 0:
        count += 1
        k = ahead.parent[k]
    first = count
    k = b
    while k >= 0:
        count += 1
        k = back.parent[k]
    times, path = np.empty(count), np.empty((count, ahead.q.shape[1]))
    k = a
    for i in range(first - 1, -1, -1):
        times[i] = ahead.t[k]
        path[i] = ahead.q[k]
        k = ahead.parent[k]
    k = b
    for i in range(first, count):
        times[i] = back.t[k]
        path[i] = back.q[k]
        k = back.parent[k]
    return times, path, back.goal[back.root[b]]


@njit(cache=True, nogil=True)
def _hurry(
    scene: Arena, query: Query, times: Array, path: Array, goal: int
) -> tuple[Array, Array]:
    """Go straight to the goal from where on the path that leads there soonest."""
    best, at = times[-1], -1
    for i in range(len(times) - 2, -1, -1):
        soon = least_time(query, path[i], times[i], goal)
        arrival = next_arrival(query, goal, soon)
        if arrival < best - _TINY and motion_clear(
            scene, path[i], times[i], query.goals[goal], arrival
        ):
            best, at = arrival, i
    if at < 0:
        return times, path
    new_times, new_path = np.empty(at + 2), np.empty((at + 2, path.shape[1]))
    new_times[: at + 1] = times[: at + 1]
    new_path[: at + 1] = path[: at + 1]
    new_times[at + 1] = best
    new_path[at + 1] = query.goals[goal]
    return new_times, new_path
