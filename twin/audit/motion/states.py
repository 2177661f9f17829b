"""States of robots between the rows of a table: configurations, speeds, accelerations at any time."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from planning.transforms import Array
from twin.audit.motion.executed import RobotRows

_SAMPLE_S = 0.01
"""So often a robot is looked at, at least, while it moves [s]."""


def moving_samples(rows: RobotRows, begin: float, end: float) -> Array:
    """Return the times of all rows in a span, its ends, and more while the robot moves."""
    low, high = np.searchsorted(rows.t, [begin, end])
    knots = np.unique(np.concatenate([[begin], rows.t[low:high], [end]]))
    assert rows.v is not None
    moves = np.any(rows.v != 0.0, axis=1)
    parts = [knots]
    for a, b in pairwise(knots.tolist()):
        k = int(np.searchsorted(rows.t, a, side="right"))
        if moves[max(k - 1, 0)] or moves[min(k, len(moves) - 1)]:
            count = int(np.ceil((b - a) / _SAMPLE_S))
            parts.append(np.linspace(a, b, count + 1)[1:-1])
    return np.unique(np.concatenate(parts))


def states_at(rows: RobotRows, t: Array) -> tuple[Array, Array, Array]:
    """Return configurations, speeds and accelerations at some times, shape (m, n) each."""
    assert rows.v is not None
    assert rows.a is not None
    k = np.clip(np.searchsorted(rows.t, t, side="right") - 1, 0, len(rows.t) - 2)
    span, since = (rows.t[k + 1] - rows.t[k])[:, None], (t - rows.t[k])[:, None]
    jerk = (rows.a[k + 1] - rows.a[k]) / span
    v = rows.v[k] + since * (rows.a[k] + 0.5 * since * jerk)
    return rows.at(t), v, rows.a[k] + since * jerk
