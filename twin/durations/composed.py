"""Durations made of other durations: later by an offset, or longer by a factor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planning.transforms import Array
from twin.durations.model import DurationModel, require


@dataclass(frozen=True)
class Shifted:
    """Another duration and a time that never varies.

    Attributes:
        model: the part that varies.
        offset_s: added to it; negative where the shortest duration leaves room for it [s].
    """

    model: DurationModel
    offset_s: float

    def __post_init__(self) -> None:
        require(np.isfinite(self.offset_s), f"shifted: offset_s {self.offset_s}")
        require(
            self.minimum >= 0,
            f"shifted: offset_s {self.offset_s} makes durations negative: the shortest "
            f"of the model is {self.model.minimum:g} s",
        )

    def ppf(self, u: Array) -> Array:
        """Return the quantiles [s] of probabilities ``u``."""
        return np.maximum(self.model.ppf(u) + self.offset_s, 0.0)

    @property
    def mean(self) -> float:
        """Expected duration [s]."""
        return self.model.mean + self.offset_s

    @property
    def sd(self) -> float:
        """Standard deviation [s]."""
        return self.model.sd

    @property
    def minimum(self) -> float:
        """Greatest lower bound [s]."""
        return self.model.minimum + self.offset_s


@dataclass(frozen=True)
class Scaled:
    """Another duration, longer or shorter by a factor.

    Attributes:
        model: the other duration.
        factor: greater than 0.
    """

    model: DurationModel
    factor: float

    def __post_init__(self) -> None:
        require(0 < self.factor < np.inf, f"scale must be above 0, not {self.factor}")

    def ppf(self, u: Array) -> Array:
        """Return the quantiles [s] of probabilities ``u``."""
        return self.factor * self.model.ppf(u)

    @property
    def mean(self) -> float:
        """Expected duration [s]."""
        return self.factor * self.model.mean

    @property
    def sd(self) -> float:
        """Standard deviation [s]."""
        return self.factor * self.model.sd

    @property
    def minimum(self) -> float:
        """Greatest lower bound [s]."""
        return self.factor * self.model.minimum
