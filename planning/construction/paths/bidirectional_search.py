"""Bidirectional space-time RRT, in compiled code (Hartmann et al. IV-C).

Two forests grow in space-time: one from the start of the robot, forwards in time, and one from goals at sampled
arrival times, backwards. A motion from (q, t) to (q', t') is possible if t < t' and no joint exceeds its speed limit.
Its length is that of eq. (5) of the paper. The distance of two configurations is the travel time of the slowest joint.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planning.construction.checks.moving_checks import is_motion_clear
from planning.construction.checks.scene import MoverScene, interpolate_configuration
from planning.construction.paths.query import (
    Query,
    arrival_time,
    draw_between,
    next_arrival,
    random_uniform,
    tree_branch,
)
from planning.construction.problem.settings import RrtSettings
from planning.kernels import ZERO, inner_kernel, kernel
from planning.packed import packed
from planning.transforms import Array, Indices

_TINY = 1e-9
_NONE = ZERO - 1
"""In place of a parent or a goal: there is none."""


class _Forest(NamedTuple):
    """Nodes in space-time.

    Attributes:
        forward: whether motions lead from parents to their children.
        size: how many nodes there are, shape (1,).
        q: shape (most, n).
        t: shape (most,) [s].
        parent: towards the root, -1 for a root, shape (most,).
        root: its root's node, shape (most,).
        goal: goal of a root, shape (most,).
    """

    forward: bool
    size: Indices
    q: Array
    t: Array
    parent: Indices
    root: Indices
    goal: Indices


def grow_forests(
    scene: MoverScene,
    query: Query,
    settings: RrtSettings,
    iterations: int,
    latest: float,
    bound: float,
    seed: int,
) -> tuple[Array, Array, int]:
    """Grow both forests, and continue to search for earlier arrivals once they have met.

    Args:
        scene: what must be kept clear of.
        query: the query.
        settings: effort.
        iterations: samples in all.
        latest: latest arrival [s].
        bound: only an arrival before this is of use [s].
        seed: of all random numbers.

    Returns:
        Times and configurations of the best path found, shapes (w,) and (w, n), empty where
        there is none; and its goal.
    """
    n, most = len(query.start), 3 * iterations + 16
    ahead, back = _new_forest(True, most, n), _new_forest(False, most, n)
    times, path, goal = _grow(
        scene, query, settings, ahead, back, iterations, latest, bound, seed
    )
    return times, path, goal


@kernel
def _grow(
    scene: MoverScene,
    query: Query,
    settings: RrtSettings,
    ahead: _Forest,
    back: _Forest,
    iterations: int,
    latest: float,
    bound: float,
    seed: int,
) -> tuple[Array, Array, int]:
    """Grow two empty forests, see ``grow_forests``."""
    n, most = len(query.start), len(ahead.t)
    state = np.zeros(1, dtype=np.uint64)
    state[0] = np.uint64(seed)
    start, gain = query.begin, settings.good_enough_s
    soonest = np.inf
    for goal in range(len(query.goals)):
        reach = arrival_time(query, query.start, start, query.goals[goal])
        soonest = min(soonest, next_arrival(query, goal, reach))
    times, path = np.empty(0), np.empty((0, n))
    found = -1
    if soonest == np.inf or soonest > latest or soonest > bound - gain:
        return times, path, found
    bound = min(bound - gain, latest)
    _add_node(ahead, query.start, start, _NONE, _NONE)
    roots = 0
    horizon = soonest + max(0.25 * (soonest - start), 1.0)
    q, new, point = np.empty(n), np.empty(n), np.empty(n)
    since, drawn = 0, 0
    forward = True
    for _ in range(iterations):
        if found >= 0 and since >= settings.patience:
            break
        drawn += 1
        since += 1
        top = min(horizon, bound)
        # Goals at ever later times: with one sample in eight, and until there are a few.
        if (roots < 4 or random_uniform(state) < 0.12) and back.size[0] < most - 4:
            goal = int(random_uniform(state) * len(query.goals))
            first = arrival_time(query, query.start, start, query.goals[goal])
            share = random_uniform(state)
            at = first + (max(top, first) - first) * share * share
            at = next_arrival(query, goal, at)
            if at <= bound and at - first < 1e9:
                _add_node(back, query.goals[goal], at, _NONE, goal)
                roots += 1
            if roots >= 4 or drawn > 40:
                horizon = start + (horizon - start) * settings.growth
                horizon = min(horizon, latest)
        behind = back.size[0]
        if behind == 0:
            continue
        root = _root_in_time(back, int(random_uniform(state) * behind), bound)
        if root < 0:
            roots = 0
            continue
        t = draw_between(query, back.goal[root], back.t[root], state, q)
        tree, other = (ahead, back) if forward else (back, ahead)
        forward = not forward
        near = _nearest_node(query, tree, q, t, settings.weight, bound)
        if near < 0 or tree.size[0] >= most - 4:
            continue
        ok, end = _extend(scene, tree, near, q, t, settings.reach, new)
        if not ok:
            continue
        at_node = _add_node(tree, new, end, near, tree.goal[near])
        # Let the other forest come to the new node.
        near = _nearest_node(query, other, new, end, settings.weight, bound)
        if near < 0:
            continue
        ok, last = _extend(scene, other, near, new, end, 1e9, point)
        if ok and abs(last - end) <= _TINY:
            a, b = (at_node, near) if tree.forward else (near, at_node)
            times, path, found = _join(ahead, a, back, b)
            times, path = _connect_straight(scene, query, times, path, found)
            bound = times[-1] - gain
            since = 0
            roots = 0
            if soonest > bound:
                break
        elif ok and other.size[0] < most - 4:
            _add_node(other, point, last, near, other.goal[near])
    return times, path, found


@inner_kernel
def _connect_straight(
    scene: MoverScene, query: Query, times: Array, path: Array, goal: int
) -> tuple[Array, Array]:
    """Connect straight to the goal from the node on the path that gives the earliest arrival."""
    best, at = times[-1], -1
    for i in range(len(times) - 2, -1, -1):
        soon = arrival_time(query, path[i], times[i], query.goals[goal])
        arrival = next_arrival(query, goal, soon)
        if arrival < best - _TINY and is_motion_clear(
            scene, path[i], times[i], query.goals[goal], arrival
        ):
            best, at = arrival, i
    if at < 0:
        return times, path
    new_times = np.append(times[: at + 1], best)
    new_path = np.concatenate((path[: at + 1], query.goals[goal : goal + 1]))
    return new_times, new_path


def _new_forest(forward: bool, most: int, n: int) -> _Forest:
    """Return an empty forest with a given capacity, for ``n`` joints."""
    return packed(
        _Forest(
            forward,
            np.zeros(1, dtype=np.int64),
            np.empty((most, n)),
            np.empty(most),
            np.empty(most, dtype=np.int64),
            np.empty(most, dtype=np.int64),
            np.empty(most, dtype=np.int64),
        )
    )


@inner_kernel
def _add_node(forest: _Forest, q: Array, t: float, parent: int, goal: int) -> int:
    """Add a node; return its number."""
    k: int = forest.size[0]
    forest.size[0] += 1
    forest.q[k] = q
    forest.t[k] = t
    forest.parent[k] = parent
    forest.root[k] = forest.root[parent] if parent >= 0 else k
    forest.goal[k] = goal
    return k


@inner_kernel
def _root_in_time(forest: _Forest, first: int, bound: float) -> int:
    """Return the root of a node, or of the next node whose root is no later than a bound.

    Nodes are looked at in a circle from ``first`` on; -1 where all roots are too late.
    """
    size = forest.size[0]
    for k in range(size):
        root: int = forest.root[(first + k) % size]
        if forest.t[root] <= bound:
            return root
    return -1


@inner_kernel
def _distance(
    query: Query, a: Array, ta: float, b: Array, tb: float, weight: float
) -> float:
    """Return eq. (5) from (a, ta) to (b, tb), inf where a joint would have to go too fast."""
    if tb <= ta + _TINY:
        return np.inf
    far = 0.0
    for j in range(len(a)):
        travel = abs(b[j] - a[j]) / query.velocity[j]
        if travel > _TINY and travel > tb - ta + _TINY:
            return np.inf
        far = max(far, travel)
    return weight * far + (1.0 - weight) * (tb - ta)


@inner_kernel
def _nearest_node(
    query: Query, forest: _Forest, q: Array, t: float, weight: float, bound: float
) -> int:
    """Return the node nearest to (q, t), forwards or backwards in time, -1 for none.

    Nodes of goals that are too late are left out.
    """
    best, at = np.inf, -1
    for k in range(forest.size[0]):
        if forest.forward:
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


@inner_kernel
def _extend(
    scene: MoverScene,
    forest: _Forest,
    near: int,
    q: Array,
    t: float,
    reach: float,
    out: Array,
) -> tuple[bool, float]:
    """Extend a node towards (q, t), half as far where that is blocked.

    Returns:
        Whether something of it is free, and the time of its end, whose configuration is
        written to ``out``.
    """
    tn = forest.t[near]
    span = min(abs(t - tn), reach)
    for _ in range(3):
        if forest.forward:
            end = t if span >= t - tn - _TINY else tn + span
            interpolate_configuration(forest.q[near], tn, q, t, end, out)
            if is_motion_clear(scene, forest.q[near], tn, out, end):
                return True, end
        else:
            end = t if span >= tn - t - _TINY else tn - span
            interpolate_configuration(q, t, forest.q[near], tn, end, out)
            if is_motion_clear(scene, out, end, forest.q[near], tn):
                return True, end
        span *= 0.4
        if span < 0.02:
            break
    return False, tn


@inner_kernel
def _join(ahead: _Forest, a: int, back: _Forest, b: int) -> tuple[Array, Array, int]:
    """Return times and configurations from the start through two nodes to a goal."""
    first, then = tree_branch(ahead.parent, a), tree_branch(back.parent, b)[::-1]
    times = np.concatenate((ahead.t[first], back.t[then]))
    path = np.concatenate((ahead.q[first], back.q[then]))
    return times, path, back.goal[back.root[b]]
