"""Durations around a mean, cut off where there can be none."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, ndtri

from planning.transforms import Array
from twin.durations.model import require

_LEAST_KEPT = 0.01


@dataclass(frozen=True)
class TruncatedNormal:
    """A normal distribution between bounds: what is outside is as if it never happened.

    Cutting off moves the mean, so ``mean`` differs from ``mean_s`` where a bound is near. At
    least 1 % of the normal distribution must be left.

    Attributes:
        mean_s: mean before it is cut off [s].
        sd_s: standard deviation before it is cut off [s].
        low_s: shortest duration, at least 0 [s].
        high_s: longest duration, infinite for none [s].
    """

    mean_s: float
    sd_s: float
    low_s: float = 0.0
    high_s: float = np.inf

    def __post_init__(self) -> None:
        require(
            np.isfinite(self.mean_s) and 0 < self.sd_s < np.inf,
            f"normal: need a finite mean_s and sd_s > 0, "
            f"not {self.mean_s} and {self.sd_s}",
        )
        require(
            abs(self.mean_s) / 1e9 <= self.sd_s,
            f"normal: mean_s {self.mean_s} is more than 1e9 times sd_s {self.sd_s}",
        )
        require(
            0 <= self.low_s < self.high_s,
            f"normal: need 0 <= low_s < high_s, not {self.low_s} and {self.high_s}",
        )
        a, b = self._bounds()
        require(
            float(ndtr(b) - ndtr(a)) >= _LEAST_KEPT,
            f"normal: less than 1 % of mean {self.mean_s} and sd {self.sd_s} is "
            f"between {self.low_s} and {self.high_s}",
        )

    def _bounds(self) -> tuple[float, float]:
        """Return the bounds in standard deviations from the mean."""
        return (
            (self.low_s - self.mean_s) / self.sd_s,
            (self.high_s - self.mean_s) / self.sd_s,
        )

    def ppf(self, u: Array) -> Array:
        """Return the quantiles [s] of probabilities ``u``."""
        below, above = (ndtr(bound) for bound in self._bounds())
        z = ndtri(below + np.asarray(u) * (above - below))
        # Rounding must not lead past a bound.
        return np.clip(self.mean_s + self.sd_s * z, self.low_s, self.high_s)

    @property
    def mean(self) -> float:
        """Expected duration [s]."""
        return self.mean_s + self.sd_s * self._moments()[0]

    @property
    def sd(self) -> float:
        """Standard deviation [s]."""
        return self.sd_s * float(np.sqrt(self._moments()[1]))

    @property
    def minimum(self) -> float:
        """Shortest duration [s]."""
        return self.low_s

    def _moments(self) -> tuple[float, float]:
        """Return mean and variance of the standardised duration."""
        a, b = self._bounds()
        kept = float(ndtr(b) - ndtr(a))
        at_a, at_b = _density(a) / kept, _density(b) / kept
        mean = at_a - at_b
        far = b * at_b if np.isfinite(b) else 0.0
        return mean, 1 + a * at_a - far - mean**2


def _density(z: float) -> float:
    # Nothing is left far out; squares of what is very far would overflow.
    return float(np.exp(-0.5 * min(abs(z), 100.0) ** 2) / np.sqrt(2 * np.pi))
