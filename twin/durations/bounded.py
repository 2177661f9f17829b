"""Durations between two bounds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import betaincinv

from planning.transforms import Array
from twin.durations.model import require

_PERT_WEIGHT = 4.0


@dataclass(frozen=True)
class Fixed:
    """Always the same duration.

    Attributes:
        value_s: the duration [s].
    """

    value_s: float

    def __post_init__(self) -> None:
        require(0 <= self.value_s < np.inf, f"fixed: value_s {self.value_s} < 0")

    def ppf(self, u: Array) -> Array:
        """Return ``value_s`` for every probability."""
        return np.full(np.shape(u), self.value_s)

    @property
    def mean(self) -> float:
        """Expected duration [s]."""
        return self.value_s

    @property
    def sd(self) -> float:
        """Standard deviation [s]."""
        return 0.0

    @property
    def minimum(self) -> float:
        """Shortest duration [s]."""
        return self.value_s


@dataclass(frozen=True)
class Uniform:
    """Anything between two bounds, equally likely.

    Attributes:
        low_s, high_s: the bounds [s].
    """

    low_s: float
    high_s: float

    def __post_init__(self) -> None:
        require(
            0 <= self.low_s <= self.high_s < np.inf,
            f"uniform: need 0 <= low_s <= high_s, not {self.low_s} and {self.high_s}",
        )

    def ppf(self, u: Array) -> Array:
        """Return the quantiles [s] of probabilities ``u``."""
        return self.low_s + np.asarray(u) * (self.high_s - self.low_s)

    @property
    def mean(self) -> float:
        """Expected duration [s]."""
        return 0.5 * (self.low_s + self.high_s)

    @property
    def sd(self) -> float:
        """Standard deviation [s]."""
        return (self.high_s - self.low_s) / float(np.sqrt(12))

    @property
    def minimum(self) -> float:
        """Shortest duration [s]."""
        return self.low_s


@dataclass(frozen=True)
class _Peaked:
    """Two bounds and the most likely duration between them.

    Attributes:
        low_s, mode_s, high_s: shortest, most likely and longest duration [s].
    """

    low_s: float
    mode_s: float
    high_s: float

    def __post_init__(self) -> None:
        require(
            0 <= self.low_s <= self.mode_s <= self.high_s < np.inf
            and self.low_s < self.high_s,
            f"{type(self).__name__.lower()}: need 0 <= low_s <= mode_s <= high_s and "
            f"low_s < high_s, not {self.low_s}, {self.mode_s} and {self.high_s}",
        )

    @property
    def minimum(self) -> float:
        """Shortest duration [s]."""
        return self.low_s


class Triangular(_Peaked):
    """Rises in a straight line to the most likely duration, and falls so."""

    def ppf(self, u: Array) -> Array:
        """Return the quantiles [s] of probabilities ``u``."""
        u = np.asarray(u)
        width = self.high_s - self.low_s
        left, right = self.mode_s - self.low_s, self.high_s - self.mode_s
        return np.where(
            u * width < left,
            self.low_s + np.sqrt(u * width * left),
            self.high_s - np.sqrt((1 - u) * width * right),
        )

    @property
    def mean(self) -> float:
        """Expected duration [s]."""
        return (self.low_s + self.mode_s + self.high_s) / 3

    @property
    def sd(self) -> float:
        """Standard deviation [s]."""
        a, c, b = self.low_s, self.mode_s, self.high_s
        return float(np.sqrt((a * a + b * b + c * c - a * b - a * c - b * c) / 18))


class Pert(_Peaked):
    """Smooth, with less weight on the bounds: the beta distribution of PERT.

    Its mean is (low + 4 mode + high) / 6.
    """

    @property
    def shapes(self) -> tuple[float, float]:
        """The two shape parameters of the beta distribution."""
        width = self.high_s - self.low_s
        return (
            1 + _PERT_WEIGHT * (self.mode_s - self.low_s) / width,
            1 + _PERT_WEIGHT * (self.high_s - self.mode_s) / width,
        )

    def ppf(self, u: Array) -> Array:
        """Return the quantiles [s] of probabilities ``u``."""
        share = betaincinv(*self.shapes, np.asarray(u))
        return np.asarray(self.low_s + share * (self.high_s - self.low_s))

    @property
    def mean(self) -> float:
        """Expected duration [s]."""
        weighted = self.low_s + _PERT_WEIGHT * self.mode_s + self.high_s
        return weighted / (_PERT_WEIGHT + 2)

    @property
    def sd(self) -> float:
        """Standard deviation [s]."""
        alpha, beta = self.shapes
        total = alpha + beta
        variance = alpha * beta / (total**2 * (total + 1))
        return (self.high_s - self.low_s) * float(np.sqrt(variance))
