"""Exponential, gamma and Weibull distributions of durations, and their fits to data."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import model_validator
from scipy.special import digamma, gamma, gammainc, gammaincinv, gammaln, polygamma

from planning.transforms import Array
from twin.durations.fittable import FittableModel, safe_log
from twin.durations.model import Factor, PositiveSeconds, Seconds, Shape, require_pair


class Exponential(FittableModel):
    """Exponential distribution, without memory: the rest does not depend on the time so far.

    Short ones are most likely, some are very long.

    Attributes:
        mean_s: mean duration [s].
    """

    title: ClassVar = "exponential"
    parameters: ClassVar = ("mean_s",)
    takes_zero: ClassVar = True

    kind: Literal["exponential"] = "exponential"
    mean_s: Seconds

    def _ppf(self, u: Array) -> Array:
        return np.asarray(-self.mean_s * np.log1p(-np.asarray(u)))

    def _mean(self) -> float:
        return self.mean_s

    @classmethod
    def fit(cls, x: Array) -> Array:
        """Return the mean of each sample."""
        return np.asarray(x.mean(axis=1, keepdims=True))

    @classmethod
    def _log_density(cls, x: Array, mean: Array) -> Array:
        return np.where(x >= 0, -x / mean - np.log(mean), -np.inf)

    @classmethod
    def _cdf(cls, x: Array, mean: Array) -> Array:
        return -np.expm1(-np.maximum(x, 0.0) / mean)


class Gamma(FittableModel):
    """Gamma distribution, skewed to the right, by shape and scale, or by mean and cv.

    Attributes:
        shape, scale_s: the mean is their product.
        mean_s, cv: expected duration [s], and standard deviation over mean.
    """

    title: ClassVar = "gamma"
    parameters: ClassVar = ("shape", "scale_s")

    kind: Literal["gamma"] = "gamma"
    shape: Shape | None = None
    scale_s: PositiveSeconds | None = None
    mean_s: PositiveSeconds | None = None
    cv: Factor | None = None

    @model_validator(mode="after")
    def _one_pair(self) -> Gamma:
        require_pair(self, ("shape", "scale_s"), ("mean_s", "cv"))
        return self

    def _shape_and_scale(self) -> tuple[float, float]:
        if self.mean_s is None or self.cv is None:
            return self.shape or 0.0, self.scale_s or 0.0
        return 1 / self.cv**2, self.mean_s * self.cv**2

    def _ppf(self, u: Array) -> Array:
        shape, scale = self._shape_and_scale()
        return np.asarray(scale * gammaincinv(shape, np.asarray(u)))

    def _mean(self) -> float:
        shape, scale = self._shape_and_scale()
        return shape * scale

    @classmethod
    def fit(cls, x: Array) -> Array:
        """Return the likeliest parameters of each sample: Newton on log k - digamma(k)."""
        mean = x.mean(axis=1)
        gap = np.log(mean) - np.log(x).mean(axis=1)
        # Minka's start, within 1.5 % of the solution.
        shape = (3 - gap + np.sqrt((gap - 3) ** 2 + 24 * gap)) / (12 * gap)
        for _ in range(6):
            error = np.log(shape) - digamma(shape) - gap
            slope = 1 / shape - polygamma(1, shape)
            shape = np.maximum(shape - error / slope, 0.1 * shape)
        return np.stack([shape, mean / shape], axis=1)

    @classmethod
    def _log_density(cls, x: Array, shape: Array, scale: Array) -> Array:
        rise = (shape - 1) * safe_log(x)
        out = rise - x / scale - gammaln(shape) - shape * np.log(scale)
        return np.where(x > 0, out, -np.inf)

    @classmethod
    def _cdf(cls, x: Array, shape: Array, scale: Array) -> Array:
        return np.asarray(gammainc(shape, np.maximum(x, 0.0) / scale))


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

    def _mean(self) -> float:
        return self.scale_s * float(gamma(1 + 1 / self.shape))

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
    def _log_density(cls, x: Array, shape: Array, scale: Array) -> Array:
        log = safe_log(x) - np.log(scale)
        out = np.log(shape / scale) + (shape - 1) * log - np.exp(shape * log)
        return np.where(x > 0, out, -np.inf)

    @classmethod
    def _cdf(cls, x: Array, shape: Array, scale: Array) -> Array:
        return np.asarray(-np.expm1(-((np.maximum(x, 0.0) / scale) ** shape)))
