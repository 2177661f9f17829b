"""Queries and results of the space-time path planner, with arrival times and random numbers in compiled code."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from planning.kernels import inner_kernel, kernel
from planning.transforms import Array, Indices

_TINY = 1e-9


class Query(NamedTuple):
    """A query for a path from a start to one of several goals within their time windows.

    Attributes:
        start: start configuration, shape (n,).
        begin: earliest time of departure [s].
        lower, upper, velocity: limits of the joints, shape (n,).
        goals: alternative goal configurations, shape (g, n).
        window_first: windows of goal k are ``range(window_first[k], window_first[k + 1])``.
        windows: time windows of arrival, in order, shape (w, 2) [s].
        rest: configuration HOME, shape (n,).
        leans: True for joints that prefer their position at HOME if they have time for it, False for joints
            of a mobile base, shape (n,).
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
        time: increasing times of the waypoints, shape (w,) [s].
        path: waypoints of straight motions, shape (w, n).
        goal: index of the reached goal.
        earliest: lower bound on the arrival at any goal [s].
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
def arrival_time(query: Query, a: Array, t: float, b: Array) -> float:
    """Return the arrival at ``b`` after leaving ``a`` at time ``t``, ignoring obstacles [s]."""
    out = t
    for j in range(len(a)):
        travel = abs(b[j] - a[j])
        if travel > 0.0:
            out = max(out, t + travel / query.velocity[j])
    return out


@kernel
def next_arrival(query: Query, goal: int, t: float) -> float:
    """Return the first time from ``t`` on within a window of a goal, infinity for none [s]."""
    for w in range(query.window_first[goal], query.window_first[goal + 1]):
        if query.windows[w, 1] >= t - _TINY:
            first: float = query.windows[w, 0]
            return max(t, first)
    return np.inf


@inner_kernel
def tree_branch(parent: Indices, last: int) -> Indices:
    """Return the nodes of a tree from its root to a given node; a root's parent is below 0."""
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
def random_uniform(state: npt.NDArray[np.uint64]) -> float:
    """Return the next random number in [0, 1): splitmix64, whose sequence depends only on the seed."""
    state[0] += np.uint64(0x9E3779B97F4A7C15)
    z = state[0]
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    share: float = np.float64(z >> np.uint64(11)) / 9007199254740992.0
    return share


@inner_kernel
def random_normal(state: npt.NDArray[np.uint64]) -> float:
    """Return an approximately normal random number: a sum of a few uniform ones."""
    total = -3.0
    for _ in range(6):
        total += random_uniform(state)
    return 1.4142 * total


@inner_kernel
def draw_between(
    query: Query,
    goal: int,
    arrival: float,
    state: npt.NDArray[np.uint64],
    out: Array,
) -> float:
    """Draw a configuration and time reachable from the start and towards a goal; return the time."""
    t = query.begin + random_uniform(state) * (arrival - query.begin)
    # While a mobile robot drives, its arm is better at HOME, where it is less often in the way.
    leaning = random_uniform(state) < 0.5 and not np.all(query.leans)
    for j in range(len(out)):
        v = query.velocity[j]
        ahead, left = v * (t - query.begin), v * (arrival - t)
        low = max(query.lower[j], query.start[j] - ahead)
        high = min(query.upper[j], query.start[j] + ahead)
        low = max(low, query.goals[goal, j] - left)
        high = min(high, query.goals[goal, j] + left)
        share = random_uniform(state)
        out[j] = 0.5 * (low + high) if high <= low else low + share * (high - low)
        if leaning and query.leans[j] and high > low:
            out[j] = min(max(query.rest[j], low), high)
        if ahead == 0.0:
            out[j] = query.start[j]
    return float(t)
