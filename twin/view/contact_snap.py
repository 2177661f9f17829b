"""Snapping of a moved body to bodies that it is about to touch, by upright boxes around them."""

from __future__ import annotations

import numpy as np

from planning.transforms import Array

SNAP_M = 0.005
"""Distance of two faces up to which they are brought together [m]."""

_APART_M = 1e-6
"""Boxes that overlap by less are beside each other [m]."""


def contact_shift(box: Array, others: Array) -> Array:
    """Return the shift after which a box touches the boxes that it nearly touches, shape (3,) [m].

    Along each axis, z first, it is the smallest one up to ``SNAP_M`` that brings a face onto the facing face of a box
    which is in front of it; zero where there is none.

    Args:
        box: lower and upper corner, shape (2, 3) [m].
        others: likewise, shape (n, 2, 3).
    """
    shift = np.zeros(3)
    for axis in (2, 0, 1):
        low, high = box + shift
        apart = (low > others[:, 1] - _APART_M) | (high < others[:, 0] + _APART_M)
        facing = others[~np.delete(apart, axis, axis=1).any(axis=1)][:, :, axis]
        gaps = np.concatenate([facing[:, 1] - low[axis], facing[:, 0] - high[axis]])
        least = gaps[np.argmin(np.abs(gaps))] if len(gaps) else np.inf
        if abs(least) < SNAP_M + _APART_M:
            shift[axis] = least
    return shift
