"""Durations without an upper bound: most near the middle, a tail of long ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import gamma as gamma_function
from scipy.special import gammaincinv, ndtri

from planning.transforms import Array
from twin.durations.model import require

_Z95 = float(ndtri(0.95))


@dataclass(frozen=True)
class Lognormal:
    """Skewed to long durations; its logarithm is normal.

    Attributes:
        median_s: half of the durations are shorter [s].
        p95_s: 95 % of the durations are shorter [s].
    """

    median_s: float
    p95_s: float

    def __post_init__(self) -> None:
        require(
            0 < self.median_s <= self.p95_s < np.inf,
            f"lognormal: need 0 < median_s <= p95_s, "
            f"not {self.median_s} and {self.p95_s}",
        )
        require(
            self.p95_s / 1e9 <= self.median_s,
            f"lognormal: p95_s {self.p95_s} is more than 1e9 times the median_s "
            f"{self.median_s}",
        )

    @classmethod
    def from_mean(cls, mean_s: float, cv: float) -> Lognormal:
        """Return the one of a mean [s] and a coefficient of variation (sd / mean)."""
        _require_mean("lognormal", mean_s, cv)
        sigma = np.sqrt(np.log1p(cv**2))
        median = mean_s / np.sqrt(1 + cv**2)
        return cls(float(median), float(median * np.exp(_Z95 * sigma)))

    @property
    def sigma(self) -> float:
        """Standard deviation of the logarithm of the duration in seconds."""
        return float(np.log(self.p95_s / self.median_s)) / _Z95

    def ppf(self, u: Array) -> Array:
        """Return the quantiles [s] of probabilities ``u``."""
        return self.median_s * np.exp(self.sigma * ndtri(np.asarray(u)))

    @property
    def mean(self) -> float:
        """Expected duration [s]."""
        return self.median_s * float(np.exp(0.5 * self.sigma**2))

    @property
    def sd(self) -> float:
        """Standard deviation [s]."""
        return self.mean * float(np.sqrt(np.expm1(self.sigma**2)))

    @property
    def minimum(self) -> float:
        """Greatest lower bound [s]."""
        return 0.0 if self.sigma > 0 else self.median_s


@dataclass(frozen=True)
class Exponential:
    """Without memory: however long it has lasted, the rest is as long as ever.

    Attributes:
        mean_s: expected duration, at least 0 [s].
    """

    mean_s: float

    def __post_init__(self) -> None:
        require(
            0 <= self.mean_s < np.inf,
            f"exponential: need mean_s >= 0, not {self.mean_s}",
        )

    def ppf(self, u: Array) -> Array:
        """Return the quantiles [s] of probabilities ``u``."""
        return np.asarray(-self.mean_s * np.log1p(-np.asarray(u)))

    @property
    def mean(self) -> float:
        """Expected duration [s]."""
        return self.mean_s

    @property
    def sd(self) -> float:
        """Standard deviation [s]."""
        return self.mean_s

    @property
    def minimum(self) -> float:
        """Greatest lower bound [s]."""
        return 0.0


@dataclass(frozen=True)
class _Shaped:
    """A shape and a scale.

    Attributes:
        shape: the greater, the narrower; above 1 there is a most likely duration.
        scale_s: stretches the durations [s].
    """

    shape: float
    scale_s: float

    def __post_init__(self) -> None:
        require(
            0 < self.shape < np.inf and 0 < self.scale_s < np.inf,
            f"{type(self).__name__.lower()}: need shape > 0 and scale_s > 0, "
            f"not {self.shape} and {self.scale_s}",
        )

    @property
    def minimum(self) -> float:
        """Greatest lower bound [s]."""
        return 0.0


class Gamma(_Shaped):
    """The time of several exponential steps in a row; the mean is shape x scale."""

    @classmethod
    def from_mean(cls, mean_s: float, cv: float) -> Gamma:
        """Return the one of a mean [s] and a coefficient of variation (sd / mean)."""
        _require_mean("gamma", mean_s, cv)
        return cls(1 / cv**2, mean_s * cv**2)

    def ppf(self, u: Array) -> Array:
        """Return the quantiles [s] of probabilities ``u``."""
        return np.asarray(self.scale_s * gammaincinv(self.shape, np.asarray(u)))

    @property
    def mean(self) -> float:
        """Expected duration [s]."""
        return self.shape * self.scale_s

    @property
    def sd(self) -> float:
        """Standard deviation [s]."""
        return self.scale_s * float(np.sqrt(self.shape))


class Weibull(_Shaped):
    """The time until the weakest of many links gives; 63 % are shorter than the scale."""

    def ppf(self, u: Array) -> Array:
        """Return the quantiles [s] of probabilities ``u``."""
        return np.asarray(
            self.scale_s * (-np.log1p(-np.asarray(u))) ** (1 / self.shape)
        )

    @property
    def mean(self) -> float:
        """Expected duration [s]."""
        return self.scale_s * float(gamma_function(1 + 1 / self.shape))

    @property
    def sd(self) -> float:
        """Standard deviation [s]."""
        second = gamma_function(1 + 2 / self.shape)
        first = gamma_function(1 + 1 / self.shape)
        return self.scale_s * float(np.sqrt(max(second - first**2, 0.0)))


def _require_mean(name: str, mean_s: float, cv: float) -> None:
    require(
        0 < mean_s < np.inf and 1e-9 <= cv < np.inf,
        f"{name}: need mean_s > 0 and cv > 0, not {mean_s} and {cv}",
    )
