"""Statistics of replications: means, quantiles and proportions with confidence intervals.

Replications are independent: each has its own random draws. A run is a terminating simulation, so there is no warm-up
period. A proportion of 0, such as 0 failures in 50 replications, has an upper confidence bound above 0.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import ceil, isfinite, log
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, PlainSerializer
from scipy import stats

from planning.errors import RequestError, TwinError
from planning.transforms import Array
from twin.host.atomic_files import finite_or_none

_SYMMETRIC = 1e-9
"""Skewness over the root of the sample size below which Hall's interval is Student's."""


@dataclass(frozen=True)
class Interval:
    """An estimate with its confidence interval.

    Attributes:
        estimate: the estimate.
        low, high: bounds of the interval; infinite on a side that the sample is too small for.
        count: replications it rests on.
        replications_needed: sample size from which both bounds are finite; None where both are.
    """

    estimate: float
    low: float
    high: float
    count: int
    replications_needed: int | None = None

    @property
    def half_width(self) -> float:
        """Distance from the estimate to the farther bound."""
        return max(self.high - self.estimate, self.estimate - self.low)

    @property
    def relative_half_width(self) -> float:
        """The half width over the estimate; 0 for a point at 0, infinite for a zero mean."""
        if self.half_width == 0:
            return 0.0
        return self.half_width / abs(self.estimate) if self.estimate else np.inf

    def content(self) -> dict[str, Any]:
        """Return it for JSON; a bound that is infinite is None."""
        needed = self.replications_needed
        return {
            "estimate": self.estimate,
            "low": finite_or_none(self.low),
            "high": finite_or_none(self.high),
            "count": self.count,
            **({} if needed is None else {"replications_needed": needed}),
        }

    def bounds(
        self, form: Callable[[float], str] = "{:.1f}".format, factor: float = 1.0
    ) -> str:
        """Return the bounds as text: both, or one and the sample size needed for the other.

        Args:
            form: returns a bound as text.
            factor: of the bounds, such as 100 for percent.

        Returns:
            Empty where both bounds are infinite and no sample size is known to help.
        """
        low, high = (form(factor * bound) for bound in (self.low, self.high))
        below, above = isfinite(self.low), isfinite(self.high)
        if below and above:
            return f"{low} to {high}"
        missing = "a lower limit" if above else "an upper limit" if below else "limits"
        known = f"at least {low}" if below else f"at most {high}" if above else ""
        needed = self.replications_needed
        hint = f"{needed} replications needed for {missing}" if needed else ""
        return "; ".join(filter(None, (known, hint)))


SummaryEntry = Annotated[Interval, PlainSerializer(Interval.content)]
"""An estimate with its interval; a bound that is infinite is None in the file."""


class Figures(BaseModel):
    """Base of figures in a file, without unset ones."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    def content(self) -> dict[str, Any]:
        """Return them for JSON."""
        return self.model_dump(mode="json", exclude_unset=True)


def mean_interval(
    values: npt.ArrayLike, *, confidence: float = 0.95, antithetic: bool = False
) -> Interval:
    """Return the mean with the union of two intervals: Student's t and Hall's for skewed samples.

    Student's interval covers too seldom where few values are skewed to the right, as makespans
    with stalls are. Hall's (1992) cubic transformation removes the skewness from the t statistic;
    its interval reaches farther on the side of the longer tail. For symmetric samples both agree.

    Args:
        values: one per replication, shape (n,).
        confidence: probability that the interval covers the mean.
        antithetic: replications 2k and 2k + 1 are mirror images; then their averages are the
            independent values, and an odd one at the end is left out.

    Raises:
        TwinError: there are no values.
    """
    sample = _sample(values)
    count = len(sample)
    if antithetic:
        if count < 2:
            raise TwinError("antithetic replications come in pairs: need at least 2")
        sample = sample[: count // 2 * 2].reshape(-1, 2).mean(axis=1)
    n, mean = len(sample), float(np.mean(sample))
    if n < 2:
        return Interval(mean, -np.inf, np.inf, count, 4 if antithetic else 2)
    low, high = mean_bounds(sample, confidence)
    return Interval(mean, float(low), float(high), count)


def mean_bounds(samples: Array, confidence: float) -> Array:
    """Return the bounds of the mean of each sample, see ``mean_interval``.

    Args:
        samples: independent values, at least 2 each, shape (..., n).
        confidence: probability that the bounds enclose the mean.

    Returns:
        Lower and upper bounds, shape (2, ...).
    """
    n, mean = samples.shape[-1], samples.mean(axis=-1)
    deviations = samples - mean[..., None]
    variance = np.mean(deviations**2, axis=-1)
    error = np.sqrt(variance / (n - 1))
    t = stats.t.ppf(0.5 + 0.5 * confidence, n - 1)
    a = np.zeros_like(mean)  # sample skewness over the root of n
    if n > 2:
        np.divide(
            np.mean(deviations**3, axis=-1), variance**1.5, out=a, where=error > 0
        )
        a *= np.sqrt(n - 1) / (n - 2)
    skewed = np.abs(a) > _SYMMETRIC
    bounds = []
    for side, own in ((t, np.maximum), (-t, np.minimum)):
        # Inverse of side = w + a w**2 / 3 + a**2 w**3 / 27 + a / 6.
        root = np.cbrt(1.0 + a * (side - a / 6.0)) - 1.0
        unskewed = np.divide(3.0 * root, a, out=np.full_like(a, side), where=skewed)
        bounds.append(mean - own(side, unskewed) * error)
    return np.stack(bounds)


def paired_interval(
    first: npt.ArrayLike,
    second: npt.ArrayLike,
    *,
    confidence: float = 0.95,
    antithetic: bool = False,
) -> Interval | None:
    """Return the mean paired difference of two samples with its interval.

    Args:
        first, second: one value per replication, NaN where there is none, shape (n,).
        confidence: probability that the interval covers the mean difference.
        antithetic: see ``mean_interval``; only counts where all values are there.

    Returns:
        None where no replication has both.
    """
    difference = np.asarray(first, dtype=float) - np.asarray(second, dtype=float)
    both = np.isfinite(difference)
    if not both.any():
        return None
    mirrored = antithetic and bool(both.all()) and len(both) > 1
    return mean_interval(difference[both], confidence=confidence, antithetic=mirrored)


def quantile_interval(
    values: npt.ArrayLike, probability: float, *, confidence: float = 0.95
) -> Interval:
    """Return a quantile with its distribution-free interval between two order statistics.

    How many of n values are at or below the quantile is binomial, whatever their distribution.
    Each side is exceeded with at most half of 1 - ``confidence``; ties make that less. A side
    for which the sample has no such value is infinite.

    Args:
        values: one per replication, shape (n,), independent.
        probability: which quantile, within (0, 1); the smallest value with at least this share
            of the sample at or below it.
        confidence: least probability that the interval covers the quantile.

    Raises:
        TwinError: there are no values.
    """
    ordered, tail = np.sort(_sample(values)), 0.5 * (1.0 - confidence)
    n = len(ordered)
    low, high = order_ranks(n, probability, tail)
    return Interval(
        float(ordered[quantile_rank(n, probability) - 1]),
        float(ordered[low - 1]) if low else -np.inf,
        float(ordered[high - 1]) if high <= n else np.inf,
        n,
        replications_needed(probability, tail) if not low or high > n else None,
    )


def order_ranks(n: int, probability: float, tail: float) -> tuple[int, int]:
    """Return the ranks of the order statistics that bound a quantile, from 1 to n.

    Args:
        n: size of the sample.
        probability: which quantile.
        tail: greatest probability that the quantile is below the lower one, and above the upper.

    Returns:
        Ranks; 0 and n + 1 where no order statistic is a bound.
    """
    low = int(stats.binom.ppf(tail, n, probability))
    return low, int(stats.binom.isf(tail, n, probability)) + 1


def quantile_rank(n: int, probability: float) -> int:
    """Return the rank of the sample's quantile."""
    return max(1, int(np.ceil(probability * n - 1e-9)))


def replications_needed(probability: float, tail: float) -> int:
    """Return the least sample size at which order statistics bound a quantile on both sides."""
    return ceil(log(tail) / log(max(probability, 1.0 - probability)) - 1e-9)


def share_interval(hits: int, count: int, *, confidence: float = 0.95) -> Interval:
    """Return a share with its Wilson interval: of runs done in time, or failed.

    Raises:
        TwinError: ``count`` is 0 or ``hits`` is not within 0 and ``count``.
    """
    if not 0 <= hits <= count or count == 0:
        raise TwinError(f"a share needs 0 <= hits <= count > 0, not {hits} of {count}")
    bounds = stats.binomtest(hits, count).proportion_ci(confidence, method="wilson")
    return Interval(hits / count, float(bounds.low), float(bounds.high), count)


@dataclass(frozen=True)
class Precision:
    """Precision at which there are enough replications.

    Attributes:
        relative_half_width: required half width of the interval of the mean.
        least, most: replications that are done at least and at most.
        confidence: of the interval.
    """

    relative_half_width: float = 0.02
    least: int = 20
    most: int = 10_000
    confidence: float = 0.95

    def __post_init__(self) -> None:
        if not (
            self.relative_half_width > 0
            and 2 <= self.least <= self.most
            and 0 < self.confidence < 1
        ):
            raise RequestError(
                "precision: need relative_half_width > 0, 2 <= least <= most and"
                f" 0 < confidence < 1, not {self}"
            )

    def reached(self, values: npt.ArrayLike, *, antithetic: bool = False) -> bool:
        """Return whether a sample is precise enough or at its maximum size."""
        count = len(np.asarray(values))
        if count < self.least:
            return False
        if count >= self.most:
            return True
        mean = mean_interval(values, confidence=self.confidence, antithetic=antithetic)
        return mean.relative_half_width <= self.relative_half_width

    def forecast(self, values: npt.ArrayLike) -> int:
        """Forecast the necessary number of replications from the present sample."""
        sample = np.asarray(values, dtype=float)
        if len(sample) < 2:
            return self.least
        mean = mean_interval(sample, confidence=self.confidence)
        ratio = mean.relative_half_width / self.relative_half_width
        if not np.isfinite(ratio):
            return self.most
        need = int(np.ceil(len(sample) * ratio**2))
        return int(np.clip(need, self.least, self.most))


def _sample(values: npt.ArrayLike) -> Array:
    sample = np.asarray(values, dtype=float).ravel()
    if len(sample) == 0:
        raise TwinError("no replications to take a statistic of")
    return sample
