"""Uniform durations and their fit."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import model_validator

from planning.transforms import Array
from twin.durations.fittable import FittableModel
from twin.durations.model import Seconds


class Uniform(FittableModel):
    """Uniform distribution between two bounds."""

    title: ClassVar = "uniform"
    parameters: ClassVar = ("low_s", "high_s")

    kind: Literal["uniform"] = "uniform"
    low_s: Seconds
    high_s: Seconds

    @model_validator(mode="after")
    def _ordered(self) -> Uniform:
        if self.low_s > self.high_s:
            raise ValueError("low_s must not exceed high_s")
        return self

    def _ppf(self, u: Array) -> Array:
        return self.low_s + np.asarray(u) * (self.high_s - self.low_s)

    def _moments(self) -> tuple[float, float]:
        mean = 0.5 * (self.low_s + self.high_s)
        return mean, (self.high_s - self.low_s) / float(np.sqrt(12))

    def _minimum(self) -> float:
        return self.low_s

    @classmethod
    def suits(cls, x: Array) -> bool:
        """Tell whether there is any spread."""
        return bool(x[0] < x[-1])

    @classmethod
    def fit(cls, x: Array) -> Array:
        """Return bounds a mean distance outside of the extremes, at least 0."""
        return np.stack(unbiased_bounds(x), axis=1)

    @classmethod
    def log_density(cls, x: Array, theta: Array) -> Array:
        """Return the logarithm of the density [1/s]."""
        low, high = theta.T[:, :, None]
        inside = (low <= x) & (x <= high)
        return np.where(inside, -np.log(high - low), -np.inf)

    @classmethod
    def cdf(cls, x: Array, theta: Array) -> Array:
        """Return the probability of not being longer."""
        low, high = theta.T[:, :, None]
        return np.asarray(np.clip((x - low) / (high - low), 0.0, 1.0))


def unbiased_bounds(x: Array) -> tuple[Array, Array]:
    """Return bounds of each sample, shape (b,) each: right on average for uniform ones.

    Likelihood would put them on the extremes of the sample, where no new duration could be
    longer. These are a mean distance between neighbours further out, and at least 0.
    """
    gap = (x[:, -1] - x[:, 0]) / (x.shape[1] - 1)
    return np.maximum(x[:, 0] - gap, 0.0), x[:, -1] + gap
