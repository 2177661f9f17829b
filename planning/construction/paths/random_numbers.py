"""Random numbers and places in space-time, compiled: a seed means one sequence."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from planning.construction.paths.query import Query
from planning.kernels import inner_kernel
from planning.transforms import Array


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
    return float(t)
