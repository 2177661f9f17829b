"""Weibull durations and their fit."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np

from planning.transforms import Array
from twin.durations.fittable import FittableModel, log_of_positive
from twin.durations.model import PositiveSeconds, Shape


class Weibull(FittableModel):
    """Weibull distribution, skewed to the right for small shapes, to the left above 3.6.

    Attributes:
        shape: the greater, the narrower.
        scale_s: 63 % of the durations are shorter [s].
    """

    title: ClassVar = "Weibull"
    parameters: ClassVar = ("shape", "scale_s")

    kind: Literal["weibull"] = "weibull"
    shape: Shape
    scale_s: PositiveSeconds

    def _ppf(self, u: Array) -> Array:
        return np.asarray(
            self.scale_s * (-np.log1p(-np.asarray(u))) ** (1 / self.shape)
        )

    def _moments(self) -> tuple[float, float]:
        from scipy.special import gamma

        first, second = gamma(1 + 1 / self.shape), gamma(1 + 2 / self.shape)
        variance = max(second - first**2, 0.0)
        return self.scale_s * float(first), self.scale_s * float(np.sqrt(variance))

    def _minimum(self) -> float:
        return 0.0

    @classmethod
    def fit(cls, x: Array) -> Array:
        """Return the likeliest parameters of each sample: Newton on the shape."""
        # Scaled by the longest, no power can overflow.
        log = np.log(x / x[:, -1:])
        middle = log.mean(axis=1)
        shape = np.pi / np.sqrt(6) / log.std(axis=1)
        for _ in range(12):
            power = np.exp(shape[:, None] * log)
            total = power.sum(axis=1)
            first = (power * log).sum(axis=1) / total
            second = (power * log**2).sum(axis=1) / total
            error = first - 1 / shape - middle
            slope = second - first**2 + 1 / shape**2
            shape = np.maximum(shape - error / slope, 0.1 * shape)
        power = np.exp(shape[:, None] * log)
        scale = x[:, -1] * power.mean(axis=1) ** (1 / shape)
        return np.stack([shape, scale], axis=1)

    @classmethod
    def log_density(cls, x: Array, theta: Array) -> Array:
        """Return the logarithm of the density [1/s]."""
        shape, scale = theta.T[:, :, None]
        log = log_of_positive(x) - np.log(scale)
        out = np.log(shape / scale) + (shape - 1) * log - np.exp(shape * log)
        return np.where(x > 0, out, -np.inf)

    @classmethod
    def cdf(cls, x: Array, theta: Array) -> Array:
        """Return the probability of not being longer."""
        shape, scale = theta.T[:, :, None]
        return np.asarray(-np.expm1(-((np.maximum(x, 0.0) / scale) ** shape)))
