"""Durations without an upper bound: most near the middle, a tail of long ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

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
