"""Families of distributions with an additional constant offset, for fits to durations."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from planning.transforms import Array
from twin.durations.fittable import FittableModel, golden_section, round_parameter

_GRID = 9
"""Number of grid points in the search for the best offset."""

_STEPS = 14
"""Steps of that search."""


@dataclass(frozen=True)
class ShiftedFamily:
    """A base family plus an offset, with parameters theta = (offset, theta of the base family).

    For each offset the other family is fitted to what is left; the likeliest offset is found on
    a grid and then by golden section. Offsets stop half a mean distance between neighbours
    short of the shortest duration: right at it, likelihoods grow without bound.

    Attributes:
        base: the other family.
        takes_zero: False, for then there is no room for an offset.
    """

    base: type[FittableModel]
    takes_zero: ClassVar[bool] = False

    @property
    def title(self) -> str:
        """In words."""
        return f"shifted {self.base.title}"

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the estimated parameters."""
        return ("offset_s", *self.base.parameters)

    def fit(self, x: Array) -> Array:
        """Return the likeliest offset of each sample, and the parameters of the rest."""
        spread = x[:, -1] - x[:, 0]
        most = np.maximum(x[:, 0] - 0.5 * spread / x.shape[1], 0.0)
        grid = most[:, None] * np.linspace(0, 1, _GRID)
        heights = np.stack([self._likelihood(x, offset) for offset in grid.T], axis=1)
        best = np.argmax(heights, axis=1)
        low = np.take_along_axis(grid, np.maximum(best - 1, 0)[:, None], 1)[:, 0]
        high = np.take_along_axis(grid, np.minimum(best + 1, _GRID - 1)[:, None], 1)
        offset = golden_section(
            lambda at: self._likelihood(x, at), low, high[:, 0], _STEPS
        )
        # The best of the grid may be better, at an end or where there are several maxima.
        on_grid = np.take_along_axis(grid, best[:, None], 1)[:, 0]
        better = self._likelihood(x, offset) >= heights.max(axis=1)
        offset = np.where(better, offset, on_grid)
        return np.column_stack([offset, self.base.fit(x - offset[:, None])])

    def log_density(self, x: Array, theta: Array) -> Array:
        """Return the logarithm of the density [1/s]."""
        return self.base.log_density(x - theta[:, :1], theta[:, 1:])

    def cdf(self, x: Array, theta: Array) -> Array:
        """Return the probability of not being longer."""
        return self.base.cdf(x - theta[:, :1], theta[:, 1:])

    def section(self, theta: Array) -> Mapping[str, Any]:
        """Return its scenario section."""
        return {
            "kind": "shifted",
            "offset_s": round_parameter(theta[0]),
            "model": dict(self.base.section(theta[1:])),
        }

    def _likelihood(self, x: Array, offset: Array) -> Array:
        """Return the logarithm of the likelihood of each sample, shape (b,)."""
        rest = x - offset[:, None]
        heights = self.base.log_density(rest, self.base.fit(rest))
        return np.asarray(heights.sum(axis=1))


Family = type[FittableModel] | ShiftedFamily
"""Distributions that differ in their parameters only."""
