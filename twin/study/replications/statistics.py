"""Statistics of replications: means, quantiles and shares with confidence intervals.

Replications are independent: each has draws of its own. An assembly ends, so there is no warm-up
to cut off. A share that was never seen, such as 0 failures of 50, still has an upper bound.

Design of a study: policies, varied inputs, and how many replications of each.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from math import ceil
from typing import Annotated, Any

import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, ConfigDict, PlainSerializer
from scipy import stats

from planning.errors import RequestError, TwinError
from planning.transforms import Array
from twin.audit.worlds.engines import Engine
from twin.host.guard import finite
from twin.run.policies import NAMED_POLICIES
from twin.scenario.variations import Variant


@dataclass(frozen=True)
class Interval:
    """An estimate with its confidence interval.

    Attributes:
        estimate: what was measured.
        low, high: bounds of the interval; infinite where the sample says nothing.
        count: replications it rests on.
    """

    estimate: float
    low: float
    high: float
    count: int

    @property
    def half_width(self) -> float:
        """Half the length of the interval."""
        return 0.5 * (self.high - self.low)

    @property
    def relative_half_width(self) -> float:
        """Half the length over the estimate; 0 for a point at 0, infinite for a zero mean."""
        if self.half_width == 0:
            return 0.0
        return self.half_width / abs(self.estimate) if self.estimate else np.inf

    def content(self) -> dict[str, Any]:
        """Return it for JSON; a bound that is infinite is None."""
        return {
            "estimate": self.estimate,
            "low": finite(self.low),
            "high": finite(self.high),
            "count": self.count,
        }


Told = Annotated[Interval, PlainSerializer(Interval.content)]
"""An estimate with its interval; a bound that is infinite is None in the file."""


class Figures(BaseModel):
    """Some figures of the file; those that were never set are not in it."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    def content(self) -> dict[str, Any]:
        """Return them for JSON."""
        return self.model_dump(mode="json", exclude_unset=True)


def mean_interval(
    values: npt.ArrayLike, *, confidence: float = 0.95, antithetic: bool = False
) -> Interval:
    """Return the mean with its Student-t interval.

    Args:
        values: one a replication, shape (n,).
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
    mean = float(np.mean(sample))
    if len(sample) < 2:
        return Interval(mean, -np.inf, np.inf, count)
    error = float(np.std(sample, ddof=1)) / np.sqrt(len(sample))
    half = float(stats.t.ppf(0.5 + 0.5 * confidence, len(sample) - 1) * error)
    return Interval(mean, mean - half, mean + half, count)


def paired_interval(
    first: npt.ArrayLike,
    second: npt.ArrayLike,
    *,
    confidence: float = 0.95,
    antithetic: bool = False,
) -> Interval | None:
    """Return by how much values are greater than others, replication by replication.

    Args:
        first, second: one value a replication, NaN where there is none, shape (n,).
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
    """Return a quantile with its percentile-bootstrap interval.

    Resampling is not simulated: the k-th smallest of n draws from the sample is at most its i-th
    smallest value exactly when k or more draws are among the i smallest, which is binomial. The
    interval is the one that infinitely many resamples would give.

    Args:
        values: one a replication, shape (n,).
        probability: which quantile, within (0, 1); the smallest value with at least this share
            of the sample at or below it.
        confidence: probability that the interval covers the quantile.

    Raises:
        TwinError: there are no values.
    """
    ordered = np.sort(_sample(values))
    n = len(ordered)
    rank = max(1, int(np.ceil(probability * n - 1e-9)))
    # Chance that a resample's quantile is at most the i-th smallest value, i = 1..n.
    chance = stats.binom.sf(rank - 1, n, np.arange(1, n + 1) / n)
    tail = 0.5 * (1.0 - confidence)
    low = ordered[min(int(np.searchsorted(chance, tail)), n - 1)]
    high = ordered[min(int(np.searchsorted(chance, 1.0 - tail)), n - 1)]
    return Interval(float(ordered[rank - 1]), float(low), float(high), n)


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
        relative_half_width: of the interval of the mean that is asked for.
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
        """Tell whether a sample is enough, or as large as it may become."""
        count = len(np.asarray(values))
        if count < self.least:
            return False
        if count >= self.most:
            return True
        mean = mean_interval(values, confidence=self.confidence, antithetic=antithetic)
        return mean.relative_half_width <= self.relative_half_width

    def forecast(self, values: npt.ArrayLike) -> int:
        """Return how many replications it will take, judged by those there are."""
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


GROWTH = 1.5
"""By how much the number of replications grows until the mean is known well enough."""


@dataclass(frozen=True)
class Block:
    """Replications that are computed together, always the same ones.

    Attributes:
        cell: index into ``Experiment.cells``.
        first, count: which replications.
    """

    cell: int
    first: int
    count: int

    @property
    def replications(self) -> range:
        """Numbers of the replications."""
        return range(self.first, self.first + self.count)


@dataclass(frozen=True)
class Experiment:
    """The design of a study.

    Attributes:
        policies: names of twin.run.policies, the first being the reference of differences.
        variants: values of the varied inputs, at least one (empty when nothing is varied).
        replications: of every policy and variant; None to go on until ``precision``.
        precision: when replications are enough, where no number of them is given.
        antithetic: replications 2k and 2k + 1 are mirror images.
        audited: replications of the open-loop policy whose motion is checked for collisions.
        audit_engine: what checks it; by default PyBullet where it is installed, else coal.
    """

    policies: tuple[str, ...]
    variants: tuple[Variant, ...] = ({},)
    replications: int | None = None
    precision: Precision = field(default_factory=Precision)
    antithetic: bool = False
    audited: int = 20
    audit_engine: Engine | None = None

    def __post_init__(self) -> None:
        for policy in self.policies:
            if policy not in NAMED_POLICIES:
                raise RequestError(
                    f"no policy {policy!r}", choices=tuple(NAMED_POLICIES)
                )
        if len(set(self.policies)) < len(self.policies) or not self.policies:
            raise RequestError(
                "a study needs at least one policy, and each of them once"
            )
        if self.replications is not None and self.replications < 1:
            raise RequestError(
                f"replications must be at least 1, not {self.replications}"
            )

    @property
    def cells(self) -> tuple[tuple[str, Variant], ...]:
        """Every policy with every variant, variant by variant."""
        return tuple((p, v) for v in self.variants for p in self.policies)

    def targets(self) -> Iterator[int]:
        """Yield numbers of replications after which to see whether they are enough."""
        if self.replications is not None:
            yield self.replications
            return
        count = self.precision.least
        while count < self.precision.most:
            yield count
            count = 2 * ceil(count * GROWTH / 2)
        yield self.precision.most


def blocks_of(cell: int, begin: int, end: int, size: int) -> Iterator[Block]:
    """Yield blocks of at most ``size`` that cover replications ``begin`` to ``end``."""
    for first in range(begin, end, size):
        yield Block(cell, first, min(size, end - first))
