"""Forests in space-time, compiled: their nodes, the nearest one, and motions to and from it.

A motion from (q, t) to (q', t') is possible where t < t' and no joint must go faster than it
can; its length is eq. (5) of Hartmann et al., with the time that the slowest joint needs as the
distance of configurations.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planning.construction.checks.motion_checks import motion_clear
from planning.construction.checks.movers import own_at
from planning.construction.checks.scene import Scene
from planning.construction.paths.query import Query
from planning.kernels import inner_kernel
from planning.transforms import Array, Indices

_TINY = 1e-9


class Forest(NamedTuple):
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


@inner_kernel
def new_forest(forward: bool, most: int, n: int) -> Forest:
    """Return a forest with room for so many nodes of ``n`` joints."""
    return Forest(
        forward,
        np.zeros(1, dtype=np.int64),
        np.empty((most, n)),
        np.empty(most),
        np.empty(most, dtype=np.int64),
        np.empty(most, dtype=np.int64),
        np.empty(most, dtype=np.int64),
    )


@inner_kernel
def add_node(forest: Forest, q: Array, t: float, parent: int, goal: int) -> int:
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


@inner_kernel
def nearest_node(
    query: Query, forest: Forest, q: Array, t: float, weight: float, bound: float
) -> int:
    """Return the node from which, or backwards to which, (q, t) is nearest, -1 for none.

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
def extend(
    scene: Scene,
    forest: Forest,
    near: int,
    q: Array,
    t: float,
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
        if forest.forward:
            end = t if span >= t - tn - _TINY else tn + span
            own_at(scene, forest.q[near], tn, q, t, end, out)
            if motion_clear(scene, forest.q[near], tn, out, end):
                return True, end
        else:
            end = t if span >= tn - t - _TINY else tn - span
            own_at(scene, q, t, forest.q[near], tn, end, out)
            if motion_clear(scene, out, end, forest.q[near], tn):
                return True, end
        span *= 0.4
        if span < 0.02:
            break
    return False, tn


@inner_kernel
def join(ahead: Forest, a: int, back: Forest, b: int) -> tuple[Array, Array, int]:
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
