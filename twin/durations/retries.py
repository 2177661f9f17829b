"""Durations of work that may have to be done again: attempts added up."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from planning.transforms import Array, readonly
from twin.durations.model import DurationModel, require

MOST_RETRIES = 20
_SEQUENCES_LOG2 = 14


@dataclass(frozen=True)
class Retries:
    """An attempt, and retries as long as attempts fail.

    Every attempt fails with the same probability, and all take times of their own. After the
    last retry allowed the work counts as done: this is a duration, not an outcome.

    The sum has no closed quantile function. ``ppf`` is that of a table: 2**14 quasi-random
    sequences of attempts (Sobol points, the same every time) for each number of retries, weighted
    by its exact probability. So one uniform makes one duration here too, and a greater uniform
    a longer one.

    Attributes:
        attempt: duration of the first attempt.
        probability: that an attempt fails, in [0, 1).
        retries: most attempts after the first, at most MOST_RETRIES.
        retry: duration of each further attempt; as the first where None.
    """

    attempt: DurationModel
    probability: float
    retries: int
    retry: DurationModel | None = None

    def __post_init__(self) -> None:
        require(
            0 <= self.probability < 1,
            f"retries: need 0 <= probability < 1, not {self.probability}",
        )
        require(
            0 <= self.retries <= MOST_RETRIES,
            f"retries: need 0 to {MOST_RETRIES} retries, not {self.retries}",
        )

    @property
    def again(self) -> DurationModel:
        """Duration of a retry."""
        return self.attempt if self.retry is None else self.retry

    @property
    def weights(self) -> Array:
        """Probability of each number of retries, shape (retries + 1,)."""
        p, k = self.probability, np.arange(self.retries + 1)
        out = p**k * (1 - p)
        out[-1] = p**self.retries
        return np.asarray(out)

    def ppf(self, u: Array) -> Array:
        """Return the quantiles [s] of probabilities ``u``, those of the table."""
        values, cumulative = _table(self)
        at = np.searchsorted(cumulative, np.asarray(u), side="left")
        return values[np.minimum(at, len(values) - 1)]

    @property
    def mean(self) -> float:
        """Expected duration [s], exact."""
        count = float(self.weights @ np.arange(self.retries + 1))
        return self.attempt.mean + count * self.again.mean

    @property
    def sd(self) -> float:
        """Standard deviation [s], exact: Wald's equation for random sums."""
        k = np.arange(self.retries + 1)
        count = float(self.weights @ k)
        spread = float(self.weights @ (k - count) ** 2)
        again = self.again
        variance = self.attempt.sd**2 + count * again.sd**2 + spread * again.mean**2
        return float(np.sqrt(variance))

    @property
    def minimum(self) -> float:
        """Greatest lower bound [s]."""
        return self.attempt.minimum


@lru_cache(maxsize=32)
def _table(model: Retries) -> tuple[Array, Array]:
    """Return durations in rising order and the probability of not being longer."""
    from scipy.stats.qmc import Sobol

    points = Sobol(model.retries + 1, scramble=False).random_base2(_SEQUENCES_LOG2)
    # The first point is 0: put all at the middle of their cells.
    u = points.T + 0.5 / len(points)
    attempts = np.vstack([model.attempt.ppf(u[:1]), model.again.ppf(u[1:])])
    sums = np.cumsum(attempts, axis=0)
    weights = np.repeat(model.weights / len(points), len(points))
    order = np.argsort(sums, axis=None, kind="stable")
    cumulative = np.cumsum(weights[order])
    return readonly(sums.ravel()[order]), readonly(cumulative / cumulative[-1])
