"""Distributions that can be fitted to measured durations, many samples at a time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar, Protocol

import numpy as np

from planning.transforms import Array
from twin.durations.model import DurationModel

LOG_ROOT_2PI = 0.5 * float(np.log(2 * np.pi))


class Family(Protocol):
    """Distributions that differ in their parameters only.

    ``x`` are samples, shape (b, n), each row rising [s]; ``theta`` are parameters, shape (b, p).
    SciPy fits one sample at a time; a bootstrap test fits hundreds.
    """

    @property
    def title(self) -> str:
        """In words, such as ``"shifted gamma"``."""
        ...

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the estimated parameters, in the order of ``theta``."""
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
        """Return the scenario section of the distribution with parameters of shape (p,)."""
        ...


class FittableModel(DurationModel):
    """A distribution whose class is a Family; subclasses say how it is fitted."""

    title: ClassVar[str]
    parameters: ClassVar[tuple[str, ...]]

    @classmethod
    def suits(cls, x: Array) -> bool:
        """Tell whether all durations are positive, and not all the same."""
        return bool(0 < x[0] < x[-1])

    @classmethod
    def section(cls, theta: Array) -> Mapping[str, Any]:
        """Return its scenario section."""
        values = (rounded(value) for value in theta)
        kind = cls.model_fields["kind"].default
        return {"kind": kind, **dict(zip(cls.parameters, values, strict=True))}


def rounded(value: float) -> float:
    """Return a parameter as a scenario gives it: seven digits that count."""
    return float(f"{value:.7g}")


def log_of_positive(x: Array) -> Array:
    """Return logarithms; whatever for what is not positive."""
    return np.asarray(np.log(np.maximum(x, 1e-300)))
