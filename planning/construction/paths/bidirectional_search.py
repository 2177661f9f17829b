"""The bi-directional space-time RRT, compiled (Hartmann et al. IV-C).

Two forests grow in space-time: one from where the movers are, forwards in time, and one from
goals at sampled arrival times, backwards.
"""

from __future__ import annotations

import numpy as np

from planning.construction.checks.motion_checks import motion_clear
from planning.construction.checks.scene import Scene
from planning.construction.paths.forest import (
    add_node,
    extend,
    join,
    nearest_node,
    new_forest,
)
from planning.construction.paths.query import Query, least_time, next_arrival
from planning.construction.paths.random_numbers import random_share, sample_between
from planning.construction.problem.settings import RrtSettings
from planning.kernels import inner_kernel, kernel
from planning.transforms import Array

_TINY = 1e-9


@kernel
def grow(
    scene: Scene,
    query: Query,
    settings: RrtSettings,
    iterations: int,
    latest: float,
    bound: float,
    seed: int,
) -> tuple[Array, Array, int]:
    """Grow both forests, and go on to arrive earlier once they have met.

    Args:
        scene: what must be kept clear of.
        query: what is asked for.
        settings: effort.
        iterations: samples in all.
        latest: no later arrival is asked for [s].
        bound: only an arrival before this is of use [s].
        seed: of all random numbers.

    Returns:
        Times and configurations of the best path found, shapes (w,) and (w, n), empty where
        there is none; and its goal.
    """
    n = len(query.start)
    most = 3 * iterations + 16
    ahead, back = new_forest(True, most, n), new_forest(False, most, n)
    state = np.zeros(1, dtype=np.uint64)
    state[0] = np.uint64(seed)
    start, gain = np.min(query.begin), settings.good_enough_s
    soonest = np.inf
    for goal in range(len(query.goals)):
        reach = least_time(query, query.start, start, goal)
        soonest = min(soonest, next_arrival(query, goal, reach))
    times, path = np.empty(0), np.empty((0, n))
    found = -1
    if soonest == np.inf or soonest > latest or soonest > bound - gain:
        return times, path, found
    bound = min(bound - gain, latest)
    add_node(ahead, query.start, start, -1, -1)
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
        if (roots < 4 or random_share(state) < 0.12) and back.size[0] < most - 4:
            goal = int(random_share(state) * len(query.goals))
            first = least_time(query, query.start, start, goal)
            share = random_share(state)
            at = first + (max(top, first) - first) * share * share
            at = next_arrival(query, goal, at)
            if at <= bound and at - first < 1e9:
                add_node(back, query.goals[goal], at, -1, goal)
                roots += 1
            if roots >= 4 or drawn > 40:
                horizon = start + (horizon - start) * settings.growth
                horizon = min(horizon, latest)
        behind = back.size[0]
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
        tree, other = (ahead, back) if forward else (back, ahead)
        forward = not forward
        near = nearest_node(query, tree, q, t, settings.weight, bound)
        if near < 0 or tree.size[0] >= most - 4:
            continue
        ok, end = extend(scene, tree, near, q, t, settings.reach, new)
        if not ok:
            continue
        at_node = add_node(tree, new, end, near, tree.goal[near])
        # Let the other forest come to the new node.
        near = nearest_node(query, other, new, end, settings.weight, bound)
        if near < 0:
            continue
        ok, last = extend(scene, other, near, new, end, 1e9, point)
        if ok and abs(last - end) <= _TINY:
            a, b = (at_node, near) if tree.forward else (near, at_node)
            times, path, found = join(ahead, a, back, b)
            times, path = _hurry(scene, query, times, path, found)
            bound = times[-1] - gain
            since = 0
            roots = 0
            if soonest > bound:
                break
        elif ok and other.size[0] < most - 4:
            add_node(other, point, last, near, other.goal[near])
    return times, path, found


@inner_kernel
def _hurry(
    scene: Scene, query: Query, times: Array, path: Array, goal: int
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
