"""Integer nanoseconds, the unit of time inside the twin: sums do not depend on their order."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Nanoseconds = npt.NDArray[np.int64]
"""Times or durations [ns]."""

NANOSECONDS = 1_000_000_000
"""Nanoseconds in a second."""


def to_nanoseconds(seconds: npt.ArrayLike) -> Nanoseconds:
    """Return times in whole nanoseconds, rounded to the nearest."""
    exact = np.asarray(seconds, dtype=float) * NANOSECONDS
    return np.asarray(np.rint(exact), dtype=np.int64)
