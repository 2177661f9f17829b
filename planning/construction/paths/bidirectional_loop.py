"""The loop of the bi-directional space-time RRT, compiled (Hartmann et al. IV-C).

Two forests grow in space-time: one from where the movers are, forwards in time, and one from
goals at sampled arrival times, backwards.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from planning.construction.checks.arena import Arena
from planning.construction.checks.motion_checks import motion_clear
from planning.construction.paths.forest import (
    add_node,
    extend,
    join,
    nearest_node,
    new_forest,
)
from planning.construction.paths.query import Query, least_time, next_arrival
from planning.construction.paths.random_numbers import random_share, sample_between
from planning.transforms import Array

_TINY = 1e-9


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
    ahead, back = new_forest(most, n), new_forest(most, n)
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
    number = add_node(ahead, 0, query.start, start, -1, -1)
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
                behind = add_node(back, behind, query.goals[goal], at, -1, goal)
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
        near = nearest_node(query, tree, size, q, t, forward, limits.weight, bound)
        if near >= 0 and size < most - 4:
            ok, end = extend(
                scene, query, tree, size, near, q, t, forward, limits.reach, new
            )
            if ok:
                goal = tree.goal[near]
                at_node = size
                if forward:
                    number = add_node(ahead, number, new, end, near, goal)
                else:
                    behind = add_node(back, behind, new, end, near, goal)
                # Let the other forest come to the new node.
                tree, size = (back, behind) if forward else (ahead, number)
                near = nearest_node(
                    query, tree, size, new, end, not forward, limits.weight, bound
                )
                if near >= 0:
                    ok, last = extend(
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
                        times, path, found = join(ahead, a, back, b)
                        times, path = _hurry(scene, query, times, path, found)
                        bound = times[-1] - limits.gain
                        since = 0
                        roots = 0
                        if soonest > bound:
                            break
                    elif ok and size < most - 4:
                        goal = tree.goal[near]
                        if forward:
                            behind = add_node(back, behind, other, last, near, goal)
                        else:
                            number = add_node(ahead, number, other, last, near, goal)
        forward = not forward
    return times, path, found, drawn, behind


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
