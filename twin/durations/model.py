"""What a duration model is."""

from __future__ import annotations

from typing import Protocol

from planning.errors import ScenarioError
from planning.transforms import Array


class DurationModel(Protocol):
    """A distribution of durations, given by its quantile function.

    One uniform makes one duration, and a greater uniform never a shorter one. So common random
    numbers and antithetic pairs (u and 1 - u) do what they should with every model.
    """

    def ppf(self, u: Array) -> Array:
        """Return the quantiles [s] of probabilities ``u`` in (0, 1), same shape."""
        ...

    @property
    def mean(self) -> float:
        """Expected duration [s]."""
        ...

    @property
    def sd(self) -> float:
        """Standard deviation [s]."""
        ...

    @property
    def minimum(self) -> float:
        """Greatest lower bound of the durations [s], at least 0."""
        ...


def require(holds: bool, message: str) -> None:
    """Raise a ScenarioError unless a condition on parameters holds."""
    if not holds:
        raise ScenarioError(message)
