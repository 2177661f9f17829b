"""Maxima of functions of one variable, many at once."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from planning.transforms import Array

_GOLDEN = float((np.sqrt(5.0) - 1) / 2)


def golden_section(
    height: Callable[[Array], Array], low: Array, high: Array, steps: int
) -> Array:
    """Return where functions are greatest between bounds, if each has one maximum there.

    Args:
        height: takes an argument for each function and returns their values, shape (b,).
        low, high: bounds, shape (b,).
        steps: each makes the interval 0.62 times as long.
    """
    width = high - low
    left, right = high - _GOLDEN * width, low + _GOLDEN * width
    at_left, at_right = height(left), height(right)
    for _ in range(steps):
        down = at_left > at_right
        low, high = np.where(down, low, left), np.where(down, right, high)
        width = high - low
        new = np.where(down, high - _GOLDEN * width, low + _GOLDEN * width)
        at_new = height(new)
        left, right = np.where(down, new, right), np.where(down, left, new)
        at_left, at_right = (
            np.where(down, at_new, at_right),
            np.where(down, at_left, at_new),
        )
    return np.asarray(0.5 * (low + high))
