"""Cubic Hermite interpolation of motions that are given by joint positions and speeds at discrete times."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from planning.transforms import Array
from twin.durations.nanoseconds import NANOSECONDS, Nanoseconds

_UNDIVIDED_NS = 30_000
"""Intervals up to this length are not subdivided, since accelerations within them are linear up to rounding [ns]."""


def cubic_at(t: Array, q: Array, v: Array, times: Array) -> tuple[Array, Array, Array]:
    """Return configurations, speeds and accelerations at given times within the rows.

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


def with_cubics(
    t: Nanoseconds, q: Array, v: Array, a: Array, bends: npt.NDArray[np.bool_]
) -> tuple[Nanoseconds, Array, Array, Array]:
    """Return rows with two more rows in every interval where the path bends.

    There configurations are no cubics of time, though path length over time and curve are cubic. Three
    cubics with continuous accelerations that meet configuration, speed and acceleration at both ends
    are unique.

    Args:
        t: times, rising, shape (rows,) [ns].
        q, v, a: configurations, speeds and accelerations, shape (rows, n).
        bends: whether the path bends after each row but the last, shape (rows - 1,).
    """
    k = np.flatnonzero(bends & (np.diff(t) > _UNDIVIDED_NS))
    if not len(k):
        return t, q, v, a
    whole = t[k + 1] - t[k]
    cuts = np.stack([whole // 3, 2 * whole // 3], axis=1)
    span = np.diff(cuts, axis=1, prepend=0, append=whole[:, None]) / NANOSECONDS
    length = span.sum(axis=1)
    left = length[:, None] - np.cumsum(span, axis=1)
    # What a constant jerk within each third adds up to at the end of all.
    gains = np.stack(
        [
            span,
            span * (left + span / 2.0),
            span * (span**2 / 6.0 + left * (span + left) / 2.0),
        ],
        axis=1,
    )
    h = length[:, None]
    lacks = np.stack(
        [
            a[k + 1] - a[k],
            v[k + 1] - v[k] - h * a[k],
            q[k + 1] - q[k] - h * (v[k] + 0.5 * h * a[k]),
        ],
        axis=1,
    )
    # In units of the whole time, so that no row of the equations is much smaller than another.
    scale = length[:, None] ** np.arange(1, 4)
    jerk = np.linalg.solve(gains / scale[:, :, None], lacks / scale[:, :, None])
    now_q, now_v, now_a = q[k], v[k], a[k]
    times = [t]
    states = [q], [v], [a]
    for third in range(2):
        s, j = span[:, third, None], jerk[:, third]
        now_q = now_q + s * (now_v + s * (now_a / 2.0 + s * j / 6.0))
        now_v = now_v + s * (now_a + s * j / 2.0)
        now_a = now_a + s * j
        times.append(t[k] + cuts[:, third])
        for part, values in zip(states, (now_q, now_v, now_a), strict=True):
            part.append(values)
    whole_t = np.concatenate(times)
    order = np.argsort(whole_t, kind="stable")
    q, v, a = (np.vstack(part)[order] for part in states)
    return whole_t[order], q, v, a
