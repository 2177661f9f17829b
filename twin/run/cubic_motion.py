"""Motions that are cubic in time between rows of positions and speeds (Hermite interpolation)."""

from __future__ import annotations

import numpy as np

from planning.transforms import Array


def cubic_at(t: Array, q: Array, v: Array, times: Array) -> tuple[Array, Array, Array]:
    """Return configurations, speeds and accelerations at some times, none before or after all rows.

    Args:
        t: times of the rows, rising, shape (rows,) [s].
        q: configurations, shape (rows, n).
        v: joint speeds, shape (rows, n).
        times: shape (times,) [s].

    Returns:
        Three arrays of shape (times, n).
    """
    still = np.zeros((len(times), q.shape[1]))
    if len(t) == 1:
        return np.repeat(q, len(times), axis=0), still, still
    k = np.clip(np.searchsorted(t, times, side="right") - 1, 0, len(t) - 2)
    span = (t[k + 1] - t[k])[:, None]
    x = np.clip((times - t[k])[:, None] / span, 0.0, 1.0)
    y = 1.0 - x
    mean = (q[k + 1] - q[k]) / span
    at = q[k] + span * (
        x * x * (3.0 - 2.0 * x) * mean + x * y * (y * v[k] - x * v[k + 1])
    )
    speed = 6.0 * x * y * mean + y * (1.0 - 3.0 * x) * v[k]
    speed += x * (3.0 * x - 2.0) * v[k + 1]
    rise = 6.0 * (1.0 - 2.0 * x) * mean - (4.0 - 6.0 * x) * v[k]
    rise -= (2.0 - 6.0 * x) * v[k + 1]
    inside = ((times >= t[0]) & (times <= t[-1]))[:, None]
    return at, np.where(inside, speed, still), np.where(inside, rise / span, still)
