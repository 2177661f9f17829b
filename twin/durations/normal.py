"""Truncated normal distribution of durations, and its fit to data."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field
from scipy.special import log_ndtr, ndtr, ndtri

from planning.bounds import LONGEST_S
from planning.errors import ScenarioError
from planning.transforms import Array
from twin.durations.fittable import LOG_ROOT_2PI, FittableModel
from twin.durations.model import PositiveSeconds, Seconds

_LEAST_KEPT = 0.01
"""Least probability of what lies between the bounds of a cut distribution."""

_CUT_MOST = 2.3
"""A normal distribution loses at most about 99 % below 0: the bound [sd from the mean]."""


class TruncatedNormal(FittableModel):
    """Normal distribution truncated at 0 or at given bounds.

    Cutting off moves the mean, so ``mean`` differs from ``mean_s`` where a bound is near. At
    least 1 % of the normal distribution must be left.

    Attributes:
        mean_s, sd_s: before it is cut off [s].
        low_s, high_s: shortest and longest duration; no longest one when not given [s].
    """

    title: ClassVar = "normal"
    parameters: ClassVar = ("mean_s", "sd_s")
    takes_zero: ClassVar = True

    kind: Literal["normal"] = "normal"
    mean_s: Annotated[float, Field(ge=-LONGEST_S, le=LONGEST_S)]
    sd_s: PositiveSeconds
    low_s: Seconds = 0.0
    high_s: PositiveSeconds | None = None

    def _located(self, folder: Path) -> TruncatedNormal:
        """Return the model; ScenarioError when hardly anything is between its bounds."""
        if abs(self.mean_s) / 1e9 > self.sd_s:
            raise ScenarioError(
                f"normal: mean_s {self.mean_s} is more than 1e9 times sd_s {self.sd_s}"
            )
        if self.low_s >= self._high_s:
            raise ScenarioError(
                f"normal: need 0 <= low_s < high_s, not {self.low_s} and {self.high_s}"
            )
        below, above = self._cut()
        if above - below < _LEAST_KEPT:
            raise ScenarioError(
                f"normal: less than 1 % of mean {self.mean_s} and sd {self.sd_s} is "
                f"between {self.low_s} and {self._high_s}"
            )
        return self

    @property
    def _high_s(self) -> float:
        return np.inf if self.high_s is None else self.high_s

    def _bounds(self) -> tuple[float, float]:
        """Return the bounds in standard deviations from the mean."""
        return (
            (self.low_s - self.mean_s) / self.sd_s,
            (self._high_s - self.mean_s) / self.sd_s,
        )

    def _cut(self) -> tuple[float, float]:
        """Return the probability of being below the lower, and the upper bound."""
        low, high = self._bounds()
        return ndtr(low), ndtr(high)

    def _ppf(self, u: Array) -> Array:
        below, above = self._cut()
        z = ndtri(below + np.asarray(u) * (above - below))
        # Rounding must not lead past a bound.
        return np.clip(self.mean_s + self.sd_s * z, self.low_s, self._high_s)

    def _mean(self) -> float:
        a, b = self._bounds()
        below, above = self._cut()
        kept = float(above - below)
        return self.mean_s + self.sd_s * (_density(a) / kept - _density(b) / kept)

    def _minimum(self) -> float:
        return self.low_s

    @classmethod
    def fit(cls, x: Array) -> Array:
        """Return the parameters whose cut-off distribution has each sample's mean and sd.

        Cut off at 0, the family is exponential in x and x**2: greatest likelihood keeps both
        their means.
        """
        mean = np.mean(x, axis=1)
        wanted = (np.std(x, axis=1) / mean) ** 2
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

    @classmethod
    def _log_density(cls, x: Array, mean: Array, sd: Array) -> Array:
        z = (x - mean) / sd
        out = -0.5 * z**2 - LOG_ROOT_2PI - np.log(sd) - log_ndtr(mean / sd)
        return np.where(x >= 0, out, -np.inf)

    @classmethod
    def _cdf(cls, x: Array, mean: Array, sd: Array) -> Array:
        cut = ndtr(-mean / sd)
        return np.asarray(np.clip((ndtr((x - mean) / sd) - cut) / (1 - cut), 0.0, 1.0))


def _density(z: float) -> float:
    # The tail vanishes far out, where squares would overflow.
    return float(np.exp(-0.5 * min(abs(z), 100.0) ** 2) / np.sqrt(2 * np.pi))


def _hazard(bound: Array) -> Array:
    """Return the hazard rate of the standard normal at a bound."""
    return np.asarray(np.exp(-0.5 * bound**2 - LOG_ROOT_2PI - log_ndtr(-bound)))


def _cut_cv2(bound: Array) -> Array:
    """Return (sd / mean)**2 of a normal that is cut off ``bound`` sd from its mean, at 0."""
    hazard = _hazard(bound)
    return np.asarray((1 - hazard * (hazard - bound)) / (hazard - bound) ** 2)
