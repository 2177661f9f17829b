"""Families without an upper bound, fitted by greatest likelihood."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import digamma, gammainc, gammaln, log_ndtr, ndtr, ndtri, polygamma

from planning.transforms import Array
from twin.fit.family import mean_and_sd, rounded

_Z95 = float(ndtri(0.95))
_LOG_ROOT = 0.5 * float(np.log(2 * np.pi))
_CUT_MOST = 2.3
"""A normal distribution loses at most about 99 % below 0: the bound [sd from the mean]."""


@dataclass(frozen=True)
class NormalFamily:
    """Normal, cut off at 0; theta = (mean, sd) before it is cut off.

    The family is exponential in x and x**2: greatest likelihood keeps both their means.
    """

    name: str = "normal"
    parameters: int = 2

    def suits(self, x: Array) -> bool:
        """Tell whether there is any spread."""
        return bool(x[0] < x[-1])

    def fit(self, x: Array) -> Array:
        """Return the parameters whose cut-off distribution has each sample's mean and sd."""
        mean, sd = mean_and_sd(x)
        wanted = (sd / mean) ** 2
        # The bound at 0, in standard deviations from the mean: the cv rises with it.
        low, high = np.full(len(x), -1e4), np.full(len(x), _CUT_MOST)
        for _ in range(60):
            middle = 0.5 * (low + high)
            too_wide = _cut_cv2(middle) > wanted
            low, high = (
                np.where(too_wide, low, middle),
                np.where(too_wide, middle, high),
            )
        bound = 0.5 * (low + high)
        sigma = mean / (_hazard(bound) - bound)
        return np.stack([-bound * sigma, sigma], axis=1)

    def log_density(self, x: Array, theta: Array) -> Array:
        """Return the logarithm of the density [1/s]."""
        mean, sd = theta.T[:, :, None]
        z = (x - mean) / sd
        out = -0.5 * z**2 - _LOG_ROOT - np.log(sd) - log_ndtr(mean / sd)
        return np.where(x >= 0, out, -np.inf)

    def cdf(self, x: Array, theta: Array) -> Array:
        """Return the probability of not being longer."""
        mean, sd = theta.T[:, :, None]
        cut = ndtr(-mean / sd)
        return np.asarray(np.clip((ndtr((x - mean) / sd) - cut) / (1 - cut), 0.0, 1.0))

    def section(self, theta: Array) -> Mapping[str, Any]:
        """Return how a scenario names it."""
        mean, sd = (rounded(v) for v in theta)
        return {"kind": "normal", "mean_s": mean, "sd_s": sd}


@dataclass(frozen=True)
class ExponentialFamily:
    """Without memory; theta = (mean,)."""

    name: str = "exponential"
    parameters: int = 1

    def suits(self, x: Array) -> bool:
        """Tell whether there is any time at all."""
        return bool(x[-1] > 0)

    def fit(self, x: Array) -> Array:
        """Return the mean of each sample."""
        return np.asarray(x.mean(axis=1, keepdims=True))

    def log_density(self, x: Array, theta: Array) -> Array:
        """Return the logarithm of the density [1/s]."""
        return np.where(x >= 0, -x / theta - np.log(theta), -np.inf)

    def cdf(self, x: Array, theta: Array) -> Array:
        """Return the probability of not being longer."""
        return -np.expm1(-np.maximum(x, 0.0) / theta)

    def section(self, theta: Array) -> Mapping[str, Any]:
        """Return how a scenario names it."""
        return {"kind": "exponential", "mean_s": rounded(theta[0])}


@dataclass(frozen=True)
class LognormalFamily:
    """Its logarithm is normal; theta = (mean, sd) of the logarithm of seconds."""

    name: str = "lognormal"
    parameters: int = 2

    def suits(self, x: Array) -> bool:
        """Tell whether all durations are positive, and not all the same."""
        return bool(0 < x[0] < x[-1])

    def fit(self, x: Array) -> Array:
        """Return mean and sd of the logarithms of each sample."""
        return np.stack(mean_and_sd(np.log(x)), axis=1)

    def log_density(self, x: Array, theta: Array) -> Array:
        """Return the logarithm of the density [1/s]."""
        mu, sigma = theta.T[:, :, None]
        log = _log(x)
        out = -0.5 * ((log - mu) / sigma) ** 2 - _LOG_ROOT - np.log(sigma) - log
        return np.where(x > 0, out, -np.inf)

    def cdf(self, x: Array, theta: Array) -> Array:
        """Return the probability of not being longer."""
        mu, sigma = theta.T[:, :, None]
        return np.where(x > 0, ndtr((_log(x) - mu) / sigma), 0.0)

    def section(self, theta: Array) -> Mapping[str, Any]:
        """Return how a scenario names it."""
        mu, sigma = theta
        return {
            "kind": "lognormal",
            "median_s": rounded(np.exp(mu)),
            "p95_s": rounded(np.exp(mu + _Z95 * sigma)),
        }


@dataclass(frozen=True)
class GammaFamily:
    """Several exponential steps in a row; theta = (shape, scale)."""

    name: str = "gamma"
    parameters: int = 2

    def suits(self, x: Array) -> bool:
        """Tell whether all durations are positive, and not all the same."""
        return bool(0 < x[0] < x[-1])

    def fit(self, x: Array) -> Array:
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

    def log_density(self, x: Array, theta: Array) -> Array:
        """Return the logarithm of the density [1/s]."""
        shape, scale = theta.T[:, :, None]
        out = (shape - 1) * _log(x) - x / scale - gammaln(shape) - shape * np.log(scale)
        return np.where(x > 0, out, -np.inf)

    def cdf(self, x: Array, theta: Array) -> Array:
        """Return the probability of not being longer."""
        shape, scale = theta.T[:, :, None]
        return np.asarray(gammainc(shape, np.maximum(x, 0.0) / scale))

    def section(self, theta: Array) -> Mapping[str, Any]:
        """Return how a scenario names it."""
        shape, scale = (rounded(v) for v in theta)
        return {"kind": "gamma", "shape": shape, "scale_s": scale}


@dataclass(frozen=True)
class WeibullFamily:
    """The weakest of many links; theta = (shape, scale)."""

    name: str = "Weibull"
    parameters: int = 2

    def suits(self, x: Array) -> bool:
        """Tell whether all durations are positive, and not all the same."""
        return bool(0 < x[0] < x[-1])

    def fit(self, x: Array) -> Array:
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

    def log_density(self, x: Array, theta: Array) -> Array:
        """Return the logarithm of the density [1/s]."""
        shape, scale = theta.T[:, :, None]
        log = _log(x) - np.log(scale)
        out = np.log(shape / scale) + (shape - 1) * log - np.exp(shape * log)
        return np.where(x > 0, out, -np.inf)

    def cdf(self, x: Array, theta: Array) -> Array:
        """Return the probability of not being longer."""
        shape, scale = theta.T[:, :, None]
        return np.asarray(-np.expm1(-((np.maximum(x, 0.0) / scale) ** shape)))

    def section(self, theta: Array) -> Mapping[str, Any]:
        """Return how a scenario names it."""
        shape, scale = (rounded(v) for v in theta)
        return {"kind": "weibull", "shape": shape, "scale_s": scale}


def _log(x: Array) -> Array:
    """Return logarithms; whatever for what is not positive."""
    return np.asarray(np.log(np.maximum(x, 1e-300)))


def _hazard(bound: Array) -> Array:
    """Return the density over what is left above a bound, of the standard normal."""
    return np.asarray(np.exp(-0.5 * bound**2 - _LOG_ROOT - log_ndtr(-bound)))


def _cut_cv2(bound: Array) -> Array:
    """Return (sd / mean)**2 of a normal that is cut off ``bound`` sd from its mean, at 0."""
    hazard = _hazard(bound)
    return np.asarray((1 - hazard * (hazard - bound)) / (hazard - bound) ** 2)
