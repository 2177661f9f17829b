"""What a family of distributions is to a fit. All arrays hold many samples at once."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np

from planning.transforms import Array


class Family(Protocol):
    """A family of distributions that can be fitted to samples, many samples at a time.

    ``x`` are samples, shape (b, n), each row rising [s]; ``theta`` are parameters, shape (b, p).
    """

    @property
    def name(self) -> str:
        """In words, such as ``"shifted gamma"``."""
        ...

    @property
    def parameters(self) -> int:
        """How many parameters are estimated."""
        ...

    def suits(self, x: Array) -> bool:
        """Tell whether one sample, shape (n,), can come from the family at all."""
        ...

    def fit(self, x: Array) -> Array:
        """Return the parameters of each sample."""
        ...

    def log_density(self, x: Array, theta: Array) -> Array:
        """Return the logarithm of the density [1/s] at each duration, shape (b, n)."""
        ...

    def cdf(self, x: Array, theta: Array) -> Array:
        """Return the probability of not being longer, shape (b, n)."""
        ...

    def section(self, theta: Array) -> Mapping[str, Any]:
        """Return how a scenario names the distribution of parameters of shape (p,)."""
        ...


def rounded(value: float) -> float:
    """Return a parameter as a scenario gives it: seven digits that count."""
    return float(f"{value:.7g}")


def mean_and_sd(x: Array) -> tuple[Array, Array]:
    """Return mean and (population) standard deviation of each sample, shape (b,)."""
    return np.mean(x, axis=1), np.std(x, axis=1)
