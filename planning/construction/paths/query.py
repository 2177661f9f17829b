"""Queries in space-time, and the bounds that speeds and time windows set, compiled."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from planning.kernels import inner_kernel, kernel
from planning.transforms import Array, Indices

_TINY = 1e-9


class Query(NamedTuple):
    """A query: from a start to one of several goals within their time windows.

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
    window_first: Indices
    windows: Array
    rest: Array
    leans: npt.NDArray[np.bool_]


@inner_kernel
def arrive(query: Query, a: Array, t: float, b: Array) -> float:
    """Return when one can be at ``b`` who leaves ``a`` at time ``t`` [s]."""
    out = t
    for j in range(len(a)):
        travel = abs(b[j] - a[j])
        if travel > 0.0:
            out = max(out, max(t, query.begin[j]) + travel / query.velocity[j])
    return out


@kernel
def least_time(query: Query, q: Array, t: float, goal: int) -> float:
    """Return how soon the goal can be reached from (q, t), obstacles aside [s]."""
    return float(arrive(query, q, t, query.goals[goal]))


@kernel
def next_arrival(query: Query, goal: int, t: float) -> float:
    """Return the first time from ``t`` on at which one may arrive at a goal, inf for none."""
    for w in range(query.window_first[goal], query.window_first[goal + 1]):
        if query.windows[w, 1] >= t - _TINY:
            first: float = query.windows[w, 0]
            return max(t, first)
    return np.inf
