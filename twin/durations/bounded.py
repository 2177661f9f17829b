"""Duration distributions with bounds (fixed, uniform, triangular, PERT), and their fits to data."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import model_validator
from scipy.special import betainc, betaincinv, betaln, xlog1py, xlogy

from planning.transforms import Array
from twin.durations.fittable import FittableModel, golden_section
from twin.durations.model import DurationModel, Seconds

_PERT_WEIGHT = 4.0
"""Weight of the mode in the PERT mean, where each bound has weight 1."""

_ROUNDS = 10
"""Rounds in which bounds and mode are fitted in turn."""

_STEPS = 10
"""Steps of the search for one of them."""


class Fixed(DurationModel):
    """A constant duration.

    Attributes:
        value_s: the duration [s].
    """

    kind: Literal["fixed"] = "fixed"
    value_s: Seconds

    def _ppf(self, u: Array) -> Array:
        return np.full(np.shape(u), self.value_s)

    def _mean(self) -> float:
        return self.value_s

    def _minimum(self) -> float:
        return self.value_s


class Uniform(FittableModel):
    """Uniform distribution between two bounds.

    Attributes:
        low_s, high_s: shortest and longest duration [s].
    """

    title: ClassVar = "uniform"
    parameters: ClassVar = ("low_s", "high_s")
    takes_zero: ClassVar = True

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

    def _mean(self) -> float:
        return 0.5 * (self.low_s + self.high_s)

    def _minimum(self) -> float:
        return self.low_s

    @classmethod
    def fit(cls, x: Array) -> Array:
        """Return bounds a mean distance outside of the extremes, at least 0."""
        return np.stack(_unbiased_bounds(x), axis=1)

    @classmethod
    def _log_density(cls, x: Array, low: Array, high: Array) -> Array:
        inside = (low <= x) & (x <= high)
        return np.where(inside, -np.log(high - low), -np.inf)

    @classmethod
    def _cdf(cls, x: Array, low: Array, high: Array) -> Array:
        return np.asarray(np.clip((x - low) / (high - low), 0.0, 1.0))


class _Peaked(FittableModel):
    """Two bounds and the most likely duration between them.

    Attributes:
        low_s, high_s: shortest and longest duration [s].
        mode_s: most likely duration [s].
    """

    parameters: ClassVar = ("low_s", "mode_s", "high_s")

    low_s: Seconds
    mode_s: Seconds
    high_s: Seconds

    @model_validator(mode="after")
    def _ordered(self) -> _Peaked:
        if not self.low_s <= self.mode_s <= self.high_s or self.low_s == self.high_s:
            raise ValueError("low_s <= mode_s <= high_s expected, low_s below high_s")
        return self

    def _minimum(self) -> float:
        return self.low_s

    @classmethod
    def fit(cls, x: Array) -> Array:
        """Return likely parameters of each sample: one after the other is made likelier.

        Bounds stay at least a thousandth of the sample's range outside of it, and at most
        twice the range.
        """
        low, high = _unbiased_bounds(x)
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
                theta = cls._likelier(x, theta, column, low, high)
        return theta

    @classmethod
    def _likelier(
        cls, x: Array, theta: Array, column: int, low: Array, high: Array
    ) -> Array:
        """Return the parameters with one of them at its likeliest between bounds."""

        def changed(values: Array) -> Array:
            out = theta.copy()
            out[:, column] = values
            return out

        def height(values: Array) -> Array:
            return np.asarray(cls.log_density(x, changed(values)).sum(axis=1))

        best = golden_section(height, low, high, _STEPS)
        better = height(best) > height(theta[:, column])
        return changed(np.where(better, best, theta[:, column]))


class Triangular(_Peaked):
    """Triangular distribution: a linear rise to the most likely duration, and a linear fall."""

    title: ClassVar = "triangular"
    kind: Literal["triangular"] = "triangular"

    def _ppf(self, u: Array) -> Array:
        u = np.asarray(u)
        width = self.high_s - self.low_s
        left, right = self.mode_s - self.low_s, self.high_s - self.mode_s
        return np.where(
            u * width < left,
            self.low_s + np.sqrt(u * width * left),
            self.high_s - np.sqrt((1 - u) * width * right),
        )

    def _mean(self) -> float:
        return (self.low_s + self.mode_s + self.high_s) / 3

    @classmethod
    def _log_density(cls, x: Array, low: Array, mode: Array, high: Array) -> Array:
        with np.errstate(divide="ignore", invalid="ignore"):
            rise, fall = (x - low) / (mode - low), (high - x) / (high - mode)
            height = np.where(x < mode, rise, np.where(x > mode, fall, 1.0))
            return np.asarray(np.log(np.maximum(height, 0.0) * 2 / (high - low)))

    @classmethod
    def _cdf(cls, x: Array, low: Array, mode: Array, high: Array) -> Array:
        x = np.clip(x, low, high)
        with np.errstate(divide="ignore", invalid="ignore"):
            below = (x - low) ** 2 / ((high - low) * (mode - low))
            above = 1 - (high - x) ** 2 / ((high - low) * (high - mode))
        return np.where(x < mode, below, np.where(high > mode, above, 1.0))


class Pert(_Peaked):
    """PERT distribution: a smooth beta distribution, with less weight on the bounds.

    Its mean is (low + 4 mode + high) / 6.
    """

    title: ClassVar = "PERT"
    kind: Literal["pert"] = "pert"

    def _shapes(self) -> tuple[float, float]:
        """Return the two shape parameters of the beta distribution."""
        width = self.high_s - self.low_s
        return (
            1 + _PERT_WEIGHT * (self.mode_s - self.low_s) / width,
            1 + _PERT_WEIGHT * (self.high_s - self.mode_s) / width,
        )

    def _ppf(self, u: Array) -> Array:
        share = betaincinv(*self._shapes(), np.asarray(u))
        return np.asarray(self.low_s + share * (self.high_s - self.low_s))

    def _mean(self) -> float:
        weighted = self.low_s + _PERT_WEIGHT * self.mode_s + self.high_s
        return weighted / (_PERT_WEIGHT + 2)

    @classmethod
    def _log_density(cls, x: Array, low: Array, mode: Array, high: Array) -> Array:
        alpha, beta = _shapes_of(low, mode, high)
        share = (x - low) / (high - low)
        inside = (share >= 0) & (share <= 1)
        share = np.where(inside, share, 0.5)
        out = xlogy(alpha - 1, share) + xlog1py(beta - 1, -share)
        out = out - betaln(alpha, beta) - np.log(high - low)
        return np.where(inside, out, -np.inf)

    @classmethod
    def _cdf(cls, x: Array, low: Array, mode: Array, high: Array) -> Array:
        share = np.clip((x - low) / (high - low), 0.0, 1.0)
        return np.asarray(betainc(*_shapes_of(low, mode, high), share))


def _unbiased_bounds(x: Array) -> tuple[Array, Array]:
    """Return bounds of each sample, shape (b,) each: right on average for uniform ones.

    Likelihood would put them on the extremes of the sample, where no new duration could be
    longer. These are a mean distance between neighbours further out, and at least 0.
    """
    gap = (x[:, -1] - x[:, 0]) / (x.shape[1] - 1)
    return np.maximum(x[:, 0] - gap, 0.0), x[:, -1] + gap


def _shapes_of(low: Array, mode: Array, high: Array) -> tuple[Array, Array]:
    """Return the shape parameters of many PERT distributions, shape (b, 1) each."""
    rise = np.asarray((mode - low) / (high - low))
    return 1 + _PERT_WEIGHT * rise, 1 + _PERT_WEIGHT * (1 - rise)
