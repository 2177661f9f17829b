"""Duration models composed of others: a constant offset plus a distribution, and attempts with retries.

The module also defines the types of scenario keys that accept any distribution.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from planning.bounds import LONGEST_S
from planning.errors import ScenarioError
from planning.transforms import Array, read_only_copy
from twin.document.section import Name, Section
from twin.durations.kinds import DurationKinds
from twin.durations.model import DurationModel, Skill

_SEQUENCES_LOG2 = 14
"""Logarithm of the number of quasi-random sequences of retries."""


class Shifted(DurationModel):
    """Shifted distribution: a constant plus another distribution.

    Attributes:
        model: the part that varies.
        offset_s: added to it; negative where the shortest duration leaves room for it [s].
    """

    kind: Literal["shifted"] = "shifted"
    model: AnyDuration
    offset_s: Annotated[float, Field(ge=-LONGEST_S, le=LONGEST_S)]

    def _located(self, folder: Path) -> Shifted:
        """Return the model with its files read; ScenarioError if durations are negative."""
        model = self.model.located(folder)
        if model.minimum + self.offset_s < 0:
            raise ScenarioError(
                f"shifted: offset_s {self.offset_s} makes durations negative: the shortest "
                f"of the model is {model.minimum:g} s"
            )
        found: Shifted = self.changed(model=model)
        return found

    def _ppf(self, u: Array) -> Array:
        return np.maximum(self.model.ppf(u) + self.offset_s, 0.0)

    def _mean(self) -> float:
        return self.model.mean + self.offset_s

    def _minimum(self) -> float:
        return self.model.minimum + self.offset_s


class Retries(DurationModel):
    """Duration with retries: an attempt plus a retry for every failed one, added up.

    Every attempt fails with the same probability, and all take times of their own. After the
    last retry allowed the work counts as done: this is a duration, not an outcome.

    The sum has no closed quantile function. ``ppf`` is that of a table: 2**14 quasi-random
    sequences of attempts (Sobol points, the same every time) for each number of retries, weighted
    by its exact probability. So one uniform makes one duration here too, and a greater uniform
    a longer one.

    Attributes:
        attempt: duration of the first attempt.
        probability: that an attempt fails.
        retries: most attempts after the first.
        retry: duration of a retry; that of the attempt when not given.
    """

    kind: Literal["retries"] = "retries"
    attempt: AnyDuration
    probability: Annotated[float, Field(ge=0, lt=1)]
    retries: Annotated[int, Field(ge=0, le=20)] = 2
    retry: AnyDuration | None = None

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

    def _located(self, folder: Path) -> Retries:
        """Return the model with its files read."""
        retry = None if self.retry is None else self.retry.located(folder)
        found: Retries = self.changed(attempt=self.attempt.located(folder), retry=retry)
        return found

    def _ppf(self, u: Array) -> Array:
        values, cumulative = _table(self)
        at = np.searchsorted(cumulative, np.asarray(u), side="left")
        return values[np.minimum(at, len(values) - 1)]

    def _mean(self) -> float:
        """Return the exact mean, by Wald's equation for random sums."""
        count = float(self.weights @ np.arange(self.retries + 1))
        return self.attempt.mean + count * self.again.mean

    def _minimum(self) -> float:
        return self.attempt.minimum


@lru_cache(maxsize=32)
def _table(model: Retries) -> tuple[Array, Array]:
    """Return sorted durations with their cumulative probabilities."""
    from scipy.stats.qmc import Sobol

    points = Sobol(model.retries + 1, scramble=False).random_base2(_SEQUENCES_LOG2)
    # The first point is 0: put all at the middle of their cells.
    u = points.T + 0.5 / len(points)
    attempts = np.vstack([model.attempt.ppf(u[:1]), model.again.ppf(u[1:])])
    sums = np.cumsum(attempts, axis=0)
    weights = np.repeat(model.weights / len(points), len(points))
    order = np.argsort(sums, axis=None, kind="stable")
    cumulative = np.cumsum(weights[order])
    return read_only_copy(sums.ravel()[order]), read_only_copy(
        cumulative / cumulative[-1]
    )


AnyDuration = Annotated[DurationModel, DurationKinds()]
"""Any distribution of durations; ``kind`` says which."""


class SkillOverride(Section):
    """An exception: a skill done by one robot, to one type of object, or both.

    The exception that names robot and object is the strongest, then the one that names the
    robot, then the one that names the object.

    Attributes:
        skill: which skill.
        robot: who does it; everyone when not given.
        object: type of what it is done to, such as ``2x4``; anything when not given.
        duration: how long it then takes.
    """

    skill: Skill
    robot: Name | None = None
    object: str | None = None
    duration: AnyDuration

    @model_validator(mode="after")
    def _names_something(self) -> SkillOverride:
        if self.robot is None and self.object is None:
            raise ValueError("name a robot, an object or both; else use 'skills'")
        return self

    def located(self, folder: Path) -> SkillOverride:
        """Return the exception with the file of its duration read; see DurationModel.located."""
        return self.changed(duration=self.duration.located(folder))


Shifted.model_rebuild()
Retries.model_rebuild()
