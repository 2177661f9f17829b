"""When one may be somewhere, and do something there: spans of time, from the fixed world."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from planning.construction.checks.checker import SpaceTimeChecker
from planning.construction.checks.free_cells import strike_out
from planning.transforms import Array

Part = tuple[SpaceTimeChecker, Array]
"""A piece of a skill: the checker that knows what is held, and the path, shape (w, n)."""


def arrival_windows(
    parts: Sequence[Part], duration: float, earliest: float, latest: float = np.inf
) -> Array:
    """Return the spans of time in which one may arrive to do a skill, or to stay.

    All parts of the skill must be clear of everything during all of its duration.

    Args:
        parts: of the skill, such as the way to a part with an empty hand and the way back
            with it; one path of one waypoint for a stand.
        duration: of the skill; infinity to stay for good [s].
        earliest, latest: times of arrival to look at [s].

    Returns:
        Spans in order, shape (w, 2); the last one may have no end.
    """
    checker = parts[0][0]
    step = checker.step
    first = int(np.floor(earliest / step + 1e-6))
    # Once nothing moves any more, all cells are alike.
    last = max(int(np.ceil(checker.world.end / step - 1e-6)), first) + 1
    if np.isfinite(latest) and np.isfinite(duration):
        last = max(min(last, int(np.ceil((latest + duration) / step))), first + 1)
    free = np.ones(max(last - first, 0), dtype=np.bool_)
    for part, path in parts:
        path = np.array(np.atleast_2d(path), dtype=np.float64)
        following = path[1:] if len(path) > 1 else path
        for a, b in zip(path, following, strict=False):
            strike_out(part.scene, a.copy(), b.copy(), first, step, free)
    return _spans(free, first, step, duration, earliest, latest)


def _spans(
    free: npt.NDArray[np.bool_],
    first: int,
    step: float,
    duration: float,
    earliest: float,
    latest: float,
) -> Array:
    """Return the spans in which a stay can begin that is free all the time."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], free.astype(np.int8), [0]])))
    out = []
    for a, b in edges.reshape(-1, 2).tolist():
        lo = max((first + a) * step, earliest)
        hi = np.inf if b == len(free) else (first + b) * step
        end = hi if np.isinf(hi) else hi - duration
        end = min(end, latest)
        if end >= lo:
            out.append((lo, end))
    return np.array(out, dtype=np.float64).reshape(-1, 2)
