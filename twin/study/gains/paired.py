"""Paired statistics: by how much a quantile falls when the same replications are made shorter."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from planning.transforms import Array, Indices
from twin.study.replications.statistics import Interval

_DRAWS = 1000
"""Resamples of the bootstrap."""


class PairedQuantiles:
    """Differences of a quantile between two samples of the same replications, with intervals.

    Both samples are resampled together (percentile bootstrap), so what they have in common does
    not widen the interval.

    Args:
        base: one value a replication, shape (n,).
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
        self._rank = max(1, int(np.ceil(probability * n - 1e-9)))
        self._tail = 0.5 * (1.0 - confidence)
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

    def fall(self, changed: npt.ArrayLike) -> Interval:
        """Return by how much the quantile of a changed sample is below that of the base."""
        values = np.asarray(changed, dtype=float)
        falls = self._resampled - self._resample(values)
        low, high = np.quantile(falls, (self._tail, 1.0 - self._tail))
        estimate = self._quantile(self._base) - self._quantile(values)
        return Interval(estimate, float(low), float(high), len(values))

    def _quantile(self, values: Array) -> float:
        return float(np.partition(values, self._rank - 1)[self._rank - 1])

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
        """Return the place of each resample's quantile among the largest values.

        It is the smallest value above which there are few enough others.
        """
        above = np.cumsum(self._weights[falling], axis=0)
        return np.asarray(np.sum(above <= len(self._base) - self._rank, axis=0))
