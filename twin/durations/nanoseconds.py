"""Integer nanoseconds, the unit of time in simulations, and their conversion from seconds.

Sums of integers do not depend on the order of addition.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from planning.bounds import LATEST_S, LONGEST_RUN_S
from planning.errors import RequestError

Nanoseconds = npt.NDArray[np.int64]
"""Times or durations [ns]."""

NANOSECONDS = 1_000_000_000
"""Nanoseconds in a second."""

_LONGEST_RUN_NS = LONGEST_RUN_S * NANOSECONDS


def to_nanoseconds(seconds: npt.ArrayLike) -> Nanoseconds:
    """Return times in whole nanoseconds, rounded to the nearest, at most LATEST_S."""
    exact = np.minimum(np.asarray(seconds, dtype=float), LATEST_S) * NANOSECONDS
    return np.asarray(np.rint(exact), dtype=np.int64)


def require_within_longest_run(t_ns: float) -> None:
    """Refuse a time beyond the longest run.

    Args:
        t_ns: a time of a run, or the time for which robots work and stand in it [ns]; infinite for never.

    Raises:
        RequestError: it is greater than LONGEST_RUN_S.
    """
    if _LONGEST_RUN_NS < t_ns < np.inf:
        raise RequestError(
            f"the run takes longer than {LONGEST_RUN_S:.0e} s: check durations, repair times and stalls"
        )
