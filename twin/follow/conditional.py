"""Conditional distributions of durations that are known to exceed some time."""

from __future__ import annotations

import numpy as np

from planning.transforms import Array
from twin.durations import DurationModel


def conditional_quantiles(model: DurationModel, least_s: float, u: Array) -> Array:
    """Return the quantiles of a duration on condition that it is longer than something.

    Args:
        model: of the duration.
        least_s: what it is known to exceed [s].
        u: probabilities in (0, 1).

    Returns:
        Same shape as ``u`` [s]; ``least_s`` where the model knows of nothing longer.
    """
    low, high = 0.0, 1.0
    for _ in range(60):
        middle = 0.5 * (low + high)
        if not low < middle < high:
            break
        if float(model.ppf(np.array([middle]))[0]) > least_s:
            high = middle
        else:
            low = middle
    if high >= 1.0:
        return np.full(np.shape(u), least_s)
    conditional = np.clip(high + (1.0 - high) * u, None, np.nextafter(1.0, 0.0))
    return np.maximum(model.ppf(conditional), least_s)
