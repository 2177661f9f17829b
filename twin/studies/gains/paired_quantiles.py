"""Paired differences of a quantile between two samples of the same replications, with confidence intervals."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from planning.transforms import Array, Indices
from twin.studies.replications.statistics import (
    Interval,
    order_ranks,
    quantile_rank,
    replications_needed,
)

_DRAWS = 1000
"""Number of bootstrap resamples."""


class PairedQuantiles:
    """Differences of a quantile between two samples of the same replications, with intervals.

    An interval is the union of two. One is the percentile bootstrap: both samples are resampled
    together, so their common variation does not widen it. Alone it is too narrow where few
    replications are beyond the quantile. The other holds the differences of the order statistics
    of equal rank, over the ranks between which ``quantile_interval`` lies; it is exact where
    the replications of both samples have the same order. Both sides are infinite for samples too
    small for these ranks.

    Args:
        base: one value per replication, shape (n,).
        probability: which quantile: the smallest value with at least this share of the sample
            at or below it.
        confidence: of the intervals.
        seed: of the resampling.
        antithetic: replications 2k and 2k + 1 are mirror images and are resampled together.
    """

    def __init__(
        self,
        base: npt.ArrayLike,
        probability: float,
        *,
        confidence: float,
        seed: int,
        antithetic: bool = False,
    ) -> None:
        self._base = np.asarray(base, dtype=float)
        n = len(self._base)
        self._rank = quantile_rank(n, probability)
        self._tail = 0.5 * (1.0 - confidence)
        self._ranks = order_ranks(n, probability, self._tail)
        self._needed = replications_needed(probability, self._tail)
        self._ordered = np.sort(self._base)
        rng = np.random.default_rng(seed)
        groups = n // 2 if antithetic and n > 1 and n % 2 == 0 else n
        chosen = rng.integers(groups, size=(_DRAWS, groups))
        chosen += groups * np.arange(_DRAWS)[:, None]
        counts = np.bincount(chosen.ravel(), minlength=_DRAWS * groups)
        counts = counts.reshape(_DRAWS, groups).astype(np.float32)
        # How often each value is in each resample, shape (n, draws).
        self._weights = np.repeat(np.ascontiguousarray(counts.T), n // groups, axis=0)
        sd = np.sqrt(2.0 * n * probability * (1.0 - probability))
        self._window = n - self._rank + int(6.0 * sd) + 8
        self._resampled = self._resample(self._base)

    def reduction(self, changed: npt.ArrayLike) -> Interval:
        """Return the reduction of a quantile from the base to a changed sample."""
        values = np.asarray(changed, dtype=float)
        ordered, n = np.sort(values), len(values)
        estimate = float(self._ordered[self._rank - 1] - ordered[self._rank - 1])
        first, last = self._ranks
        if not first or last > n:
            return Interval(estimate, -np.inf, np.inf, n, self._needed)
        falls = self._resampled - self._resample(values)
        shifts = (self._ordered - ordered)[first - 1 : last]
        low, high = np.quantile(falls, (self._tail, 1.0 - self._tail))
        return Interval(
            estimate, float(min(low, *shifts)), float(max(high, *shifts)), n
        )

    def _resample(self, values: Array) -> Array:
        """Return the quantile of every resample, shape (draws,)."""
        order = np.argsort(values, kind="stable")[::-1]
        window = min(self._window, len(order))
        place = self._place(order[:window])
        # A resample may have its quantile further down than nearly all have it.
        if np.any(place == window):
            place = self._place(order)
        return np.asarray(values[order[place]])

    def _place(self, falling: Indices) -> Indices:
        """Return the rank of each resample's quantile among the largest values.

        It is the smallest value above which there are few enough others.
        """
        above = np.cumsum(self._weights[falling], axis=0)
        return np.asarray(np.sum(above <= len(self._base) - self._rank, axis=0))
