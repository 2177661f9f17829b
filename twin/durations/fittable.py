"""Base class of duration distributions that can be fitted to measured data, for many samples in one call."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import numpy as np

from planning.transforms import Array
from twin.durations.model import DurationModel

LOG_ROOT_2PI = 0.5 * float(np.log(2 * np.pi))
_GOLDEN = float((np.sqrt(5.0) - 1) / 2)


class FittableModel(DurationModel):
    """A distribution that can be fitted; its class stands for all those parameters.

    ``x`` are samples, shape (b, n), each row rising [s]; ``theta`` are parameters, shape (b, p).
    SciPy fits one sample at a time; a bootstrap test fits hundreds.

    Attributes:
        title: in words, such as ``"gamma"``.
        parameters: names of the estimated parameters, in the order of ``theta``.
        takes_zero: whether a duration can be 0.
    """

    title: ClassVar[str]
    parameters: ClassVar[tuple[str, ...]]
    takes_zero: ClassVar[bool] = False

    @classmethod
    @abstractmethod
    def fit(cls, x: Array) -> Array:
        """Return the parameters of each sample."""

    @classmethod
    def log_density(cls, x: Array, theta: Array) -> Array:
        """Return the logarithm of the density [1/s] at each duration, shape (b, n)."""
        return cls._log_density(x, *theta.T[:, :, None])

    @classmethod
    def cdf(cls, x: Array, theta: Array) -> Array:
        """Return the probability of not being longer, shape (b, n)."""
        return cls._cdf(x, *theta.T[:, :, None])

    @classmethod
    def section(cls, theta: Array) -> Mapping[str, Any]:
        """Return the scenario section of the distribution with parameters of shape (p,)."""
        values = (round_parameter(value) for value in theta)
        kind = cls.model_fields["kind"].default
        return {"kind": kind, **dict(zip(cls.parameters, values, strict=True))}

    @classmethod
    @abstractmethod
    def _log_density(cls, *args: Any, **parameters: Any) -> Array:
        """Return ``log_density``; takes the durations and each parameter, shape (b, 1)."""

    @classmethod
    @abstractmethod
    def _cdf(cls, *args: Any, **parameters: Any) -> Array:
        """Return ``cdf``; takes the durations and each parameter, shape (b, 1)."""


def golden_section(
    height: Callable[[Array], Array], low: Array, high: Array, steps: int
) -> Array:
    """Return the maxima of unimodal functions between bounds.

    Args:
        height: takes an argument for each function and returns their values, shape (b,).
        low, high: bounds, shape (b,).
        steps: each makes the interval 0.62 times as long.
    """
    width = high - low
    left, right = high - _GOLDEN * width, low + _GOLDEN * width
    at_left, at_right = height(left), height(right)
    for _ in range(steps):
        down = at_left > at_right
        low, high = np.where(down, low, left), np.where(down, right, high)
        width = high - low
        new = np.where(down, high - _GOLDEN * width, low + _GOLDEN * width)
        at_new = height(new)
        left, right = np.where(down, new, right), np.where(down, left, new)
        at_left, at_right = (
            np.where(down, at_new, at_right),
            np.where(down, at_left, at_new),
        )
    return np.asarray(0.5 * (low + high))


def round_parameter(value: float) -> float:
    """Return a parameter rounded to seven significant digits."""
    return float(f"{value:.7g}")


def safe_log(x: Array) -> Array:
    """Return logarithms; an arbitrary value where the argument is not positive."""
    return np.asarray(np.log(np.maximum(x, 1e-300)))
