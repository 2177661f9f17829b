"""Durations between two bounds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planning.transforms import Array
from twin.durations.model import require


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
