"""Families with two bounds: uniform, triangular, PERT.

Likelihood would put the bounds of a uniform distribution on the extremes of the sample, where no
new duration could be longer. They are put where they are right on average instead, a mean
distance between neighbours further out.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import betainc, betaln, xlog1py, xlogy

from planning.transforms import Array
from twin.fit.family import rounded
from twin.fit.search import golden_section

_PERT_WEIGHT = 4.0
_ROUNDS = 10
_STEPS = 10


@dataclass(frozen=True)
class UniformFamily:
    """Anything between two bounds; theta = (low, high)."""

    name: str = "uniform"
    parameters: int = 2

    def suits(self, x: Array) -> bool:
        """Tell whether there is any spread."""
        return bool(x[0] < x[-1])

    def fit(self, x: Array) -> Array:
        """Return bounds a mean distance outside of the extremes, at least 0."""
        return np.stack(_bounds(x), axis=1)

    def log_density(self, x: Array, theta: Array) -> Array:
        """Return the logarithm of the density [1/s]."""
        low, high = theta.T[:, :, None]
        inside = (low <= x) & (x <= high)
        return np.where(inside, -np.log(high - low), -np.inf)

    def cdf(self, x: Array, theta: Array) -> Array:
        """Return the probability of not being longer."""
        low, high = theta.T[:, :, None]
        return np.asarray(np.clip((x - low) / (high - low), 0.0, 1.0))

    def section(self, theta: Array) -> Mapping[str, Any]:
        """Return how a scenario names it."""
        low, high = (rounded(v) for v in theta)
        return {"kind": "uniform", "low_s": low, "high_s": high}


@dataclass(frozen=True)
class _PeakedFamily(ABC):
    """Two bounds and a mode; theta = (low, mode, high)."""

    name: str
    parameters: int = 3

    def suits(self, x: Array) -> bool:
        """Tell whether there is any spread, and nothing at 0, where the density is none."""
        return bool(0 < x[0] < x[-1])

    def fit(self, x: Array) -> Array:
        """Return likely parameters of each sample: one after the other is made likelier.

        Bounds stay at least a thousandth of the sample's range outside of it, and at most
        twice the range.
        """
        low, high = _bounds(x)
        middle = np.clip(3 * x.mean(axis=1) - low - high, low, high)
        theta = np.stack([low, middle, high], axis=1)
        spread = x[:, -1] - x[:, 0]
        least = np.maximum(x[:, 0] - 2 * spread, 0.0)
        inner = np.maximum(x[:, 0] - 1e-3 * spread, 0.0)
        outer = x[:, -1] + 1e-3 * spread
        for _ in range(_ROUNDS):
            for column, low, high in (
                (1, theta[:, 0], theta[:, 2]),
                (0, least, np.minimum(inner, theta[:, 1])),
                (2, np.maximum(outer, theta[:, 1]), x[:, -1] + 2 * spread),
            ):
                theta = self._likelier(x, theta, column, low, high)
        return theta

    def _likelier(
        self, x: Array, theta: Array, column: int, low: Array, high: Array
    ) -> Array:
        """Return the parameters with one of them at its likeliest between bounds."""

        def changed(values: Array) -> Array:
            out = theta.copy()
            out[:, column] = values
            return out

        def height(values: Array) -> Array:
            return np.asarray(self.log_density(x, changed(values)).sum(axis=1))

        best = golden_section(height, low, high, _STEPS)
        better = height(best) > height(theta[:, column])
        return changed(np.where(better, best, theta[:, column]))

    @abstractmethod
    def log_density(self, x: Array, theta: Array) -> Array:
        """Return the logarithm of the density [1/s]."""

    def section(self, theta: Array) -> Mapping[str, Any]:
        """Return how a scenario names it."""
        low, mode, high = (rounded(v) for v in theta)
        return {"kind": self.name.lower(), "low_s": low, "mode_s": mode, "high_s": high}


@dataclass(frozen=True)
class TriangularFamily(_PeakedFamily):
    """Two bounds and a mode, straight lines between."""

    name: str = "triangular"

    def log_density(self, x: Array, theta: Array) -> Array:
        """Return the logarithm of the density [1/s]."""
        low, mode, high = theta.T[:, :, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            rise, fall = (x - low) / (mode - low), (high - x) / (high - mode)
            height = np.where(x < mode, rise, np.where(x > mode, fall, 1.0))
            return np.asarray(np.log(np.maximum(height, 0.0) * 2 / (high - low)))

    def cdf(self, x: Array, theta: Array) -> Array:
        """Return the probability of not being longer."""
        low, mode, high = theta.T[:, :, None]
        x = np.clip(x, low, high)
        with np.errstate(divide="ignore", invalid="ignore"):
            below = (x - low) ** 2 / ((high - low) * (mode - low))
            above = 1 - (high - x) ** 2 / ((high - low) * (high - mode))
        return np.where(x < mode, below, np.where(high > mode, above, 1.0))


@dataclass(frozen=True)
class PertFamily(_PeakedFamily):
    """Two bounds and a mode, a beta distribution."""

    name: str = "PERT"

    def log_density(self, x: Array, theta: Array) -> Array:
        """Return the logarithm of the density [1/s]."""
        low, _, high = theta.T[:, :, None]
        alpha, beta = self._shapes(theta)
        share = (x - low) / (high - low)
        inside = (share >= 0) & (share <= 1)
        share = np.where(inside, share, 0.5)
        out = xlogy(alpha - 1, share) + xlog1py(beta - 1, -share)
        out = out - betaln(alpha, beta) - np.log(high - low)
        return np.where(inside, out, -np.inf)

    def cdf(self, x: Array, theta: Array) -> Array:
        """Return the probability of not being longer."""
        low, _, high = theta.T[:, :, None]
        share = np.clip((x - low) / (high - low), 0.0, 1.0)
        return np.asarray(betainc(*self._shapes(theta), share))

    def _shapes(self, theta: Array) -> tuple[Array, Array]:
        low, mode, high = theta.T[:, :, None]
        rise = (mode - low) / (high - low)
        return 1 + _PERT_WEIGHT * rise, 1 + _PERT_WEIGHT * (1 - rise)


def _bounds(x: Array) -> tuple[Array, Array]:
    """Return bounds of each sample, (b,) each: unbiased for uniform ones, at least 0."""
    n = x.shape[1]
    gap = (x[:, -1] - x[:, 0]) / (n - 1)
    return np.maximum(x[:, 0] - gap, 0.0), x[:, -1] + gap
