"""A motion from rest to rest, written by hand."""

from __future__ import annotations

import numpy as np

from planning.transforms import Array


def swing(jerk: float, seconds: float) -> tuple[Array, Array, Array, Array]:
    """From rest to rest in four stretches of constant jerk: times, ways, speeds, accelerations."""
    t = np.arange(5) * seconds
    q, v, a = np.zeros(5), np.zeros(5), np.zeros(5)
    for k, j in enumerate((jerk, -jerk, -jerk, jerk)):
        a[k + 1] = a[k] + j * seconds
        v[k + 1] = v[k] + a[k] * seconds + j * seconds**2 / 2.0
        q[k + 1] = (
            q[k] + v[k] * seconds + a[k] * seconds**2 / 2.0 + j * seconds**3 / 6.0
        )
    return t, q, v, a
