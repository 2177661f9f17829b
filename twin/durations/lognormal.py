"""Lognormal distribution of durations, and its fit to data."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import model_validator
from scipy.special import ndtr, ndtri

from planning.errors import ScenarioError
from planning.transforms import Array
from twin.durations.fittable import (
    LOG_ROOT_2PI,
    FittableModel,
    round_parameter,
    safe_log,
)
from twin.durations.model import Factor, PositiveSeconds, require_pair

_Z95 = 1.6448536269514722
"""95 % of a standard normal distribution are below."""


class Lognormal(FittableModel):
    """Lognormal distribution, skewed to the right, by median and 95th percentile, or mean and cv.

    Attributes:
        median_s, p95_s: half and 95 % of the durations are shorter [s].
        mean_s, cv: expected duration [s], and standard deviation over mean.
    """

    title: ClassVar = "lognormal"
    parameters: ClassVar = ("median_s", "p95_s")

    kind: Literal["lognormal"] = "lognormal"
    median_s: PositiveSeconds | None = None
    p95_s: PositiveSeconds | None = None
    mean_s: PositiveSeconds | None = None
    cv: Factor | None = None

    @model_validator(mode="after")
    def _one_pair(self) -> Lognormal:
        require_pair(self, ("median_s", "p95_s"), ("mean_s", "cv"))
        if (self.p95_s or 0.0) < (self.median_s or 0.0):
            raise ValueError("p95_s must not be less than median_s")
        return self

    def _located(self, folder: Path) -> Lognormal:
        """Return the model; ScenarioError when it is wider than numbers go."""
        median, p95 = self._quantiles()
        if p95 / 1e9 > median:
            raise ScenarioError(
                f"lognormal: p95_s {p95} is more than 1e9 times the median_s {median}"
            )
        return self

    def _quantiles(self) -> tuple[float, float]:
        """Return median and 95th percentile [s]."""
        if self.mean_s is None or self.cv is None:
            return self.median_s or 0.0, self.p95_s or 0.0
        sigma = np.sqrt(np.log1p(self.cv**2))
        median = self.mean_s / np.sqrt(1 + self.cv**2)
        return float(median), float(median * np.exp(_Z95 * sigma))

    def _median_and_sigma(self) -> tuple[float, float]:
        """Return the median [s] and the standard deviation of the logarithm of seconds."""
        median, p95 = self._quantiles()
        if median <= 0.0:  # a mean so small that its median is no number any more
            return 0.0, 0.0
        return median, float(np.log(p95 / median)) / _Z95

    def _ppf(self, u: Array) -> Array:
        median, sigma = self._median_and_sigma()
        return np.asarray(median * np.exp(sigma * ndtri(np.asarray(u))))

    def _mean(self) -> float:
        median, sigma = self._median_and_sigma()
        return median * float(np.exp(0.5 * sigma**2))

    def _minimum(self) -> float:
        median, sigma = self._median_and_sigma()
        return 0.0 if sigma > 0 else median

    @classmethod
    def fit(cls, x: Array) -> Array:
        """Return mean and sd of the logarithms of each sample."""
        log = np.log(x)
        return np.stack([np.mean(log, axis=1), np.std(log, axis=1)], axis=1)

    @classmethod
    def _log_density(cls, x: Array, mu: Array, sigma: Array) -> Array:
        log = safe_log(x)
        out = -0.5 * ((log - mu) / sigma) ** 2 - LOG_ROOT_2PI - np.log(sigma) - log
        return np.where(x > 0, out, -np.inf)

    @classmethod
    def _cdf(cls, x: Array, mu: Array, sigma: Array) -> Array:
        return np.where(x > 0, ndtr((safe_log(x) - mu) / sigma), 0.0)

    @classmethod
    def section(cls, theta: Array) -> Mapping[str, Any]:
        """Return its scenario section."""
        mu, sigma = theta
        return {
            "kind": "lognormal",
            "median_s": round_parameter(np.exp(mu)),
            "p95_s": round_parameter(np.exp(mu + _Z95 * sigma)),
        }
