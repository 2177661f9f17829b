"""Exponential durations and their fit."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np

from planning.transforms import Array
from twin.durations.fittable import FittableModel
from twin.durations.model import Seconds


class Exponential(FittableModel):
    """Exponential distribution, without memory: the rest does not depend on the time so far.

    Short ones are most likely, some are very long.
    """

    title: ClassVar = "exponential"
    parameters: ClassVar = ("mean_s",)

    kind: Literal["exponential"] = "exponential"
    mean_s: Seconds

    def _ppf(self, u: Array) -> Array:
        return np.asarray(-self.mean_s * np.log1p(-np.asarray(u)))

    def _moments(self) -> tuple[float, float]:
        return self.mean_s, self.mean_s

    def _minimum(self) -> float:
        return 0.0

    @classmethod
    def suits(cls, x: Array) -> bool:
        """Tell whether there is any time at all."""
        return bool(x[-1] > 0)

    @classmethod
    def fit(cls, x: Array) -> Array:
        """Return the mean of each sample."""
        return np.asarray(x.mean(axis=1, keepdims=True))

    @classmethod
    def log_density(cls, x: Array, theta: Array) -> Array:
        """Return the logarithm of the density [1/s]."""
        return np.where(x >= 0, -x / theta - np.log(theta), -np.inf)

    @classmethod
    def cdf(cls, x: Array, theta: Array) -> Array:
        """Return the probability of not being longer."""
        return -np.expm1(-np.maximum(x, 0.0) / theta)
