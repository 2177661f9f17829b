"""Candidate distributions for a sample of durations: fit, goodness-of-fit test and ranking."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from planning.errors import ScenarioError
from planning.progress import Progress, no_progress
from planning.transforms import Array
from twin.durations.composed import AnyDuration
from twin.durations.model import DurationModel
from twin.fit.shifted import Family, ShiftedFamily
from twin.registry import DURATIONS

_SHIFTED = ("exponential", "lognormal", "gamma", "weibull")
"""Kinds that are fitted with an offset, too."""

FAMILIES: tuple[Family, ...] = (
    *map(DURATIONS.load, ("uniform", "triangular", "pert", "normal", *_SHIFTED)),
    *(ShiftedFamily(DURATIONS.load(kind)) for kind in _SHIFTED),
)
"""Families that are fitted."""

LEVEL = 0.05
"""Significance level: a family with a lower p-value is rejected."""

_CELLS = 200_000
"""Greatest number of resampled values that are fitted at once, to bound the memory."""

_LEAST_SPREAD = 1e-4
"""A sample varies if its range is at least this share of its greatest value."""

_SECTION: TypeAdapter[DurationModel] = TypeAdapter(AnyDuration)


@dataclass(frozen=True)
class Candidate:
    """A family fitted to a sample.

    Attributes:
        family: the family.
        theta: its parameters, shape (p,).
        section: its scenario section.
        aicc: Akaike's information criterion, corrected for small samples; less is better.
        anderson_darling: A**2, how far the sample is from the distribution.
        p_value: probability of an A**2 as great when the family is right.
    """

    family: Family
    theta: Array
    section: Mapping[str, Any]
    aicc: float
    anderson_darling: float
    p_value: float

    @property
    def rejected(self) -> bool:
        """True if the test rejects the family for this sample."""
        return self.p_value < LEVEL

    @property
    def model(self) -> DurationModel:
        """The distribution, as a scenario with ``section`` draws from it."""
        return section_model(self.section)


def fit_candidates(
    values: Array,
    *,
    resamples: int = 199,
    seed: int = 0,
    progress: Progress = no_progress,
) -> tuple[Candidate, ...]:
    """Fit every family that suits a sample, and rank them.

    Those that the test does not reject come first, in each part by their AICc. The probability of
    A**2 is found by parametric bootstrap: samples are drawn from the fitted distribution and
    the family is fitted to each of them, because critical values of textbooks hold only where
    no parameter was estimated.

    Args:
        values: durations, shape (n,), at least 6 [s].
        resamples: bootstrap samples a family.
        seed: of the bootstrap.
        progress: receives the number of finished families.

    Returns:
        The candidates, best first; none where all durations are the same, but for less than
        1/10,000.
    """
    x = np.sort(values)
    varies = x[-1] - x[0] > _LEAST_SPREAD * x[-1]
    positive = x[0] > 0
    suiting = [f for f in FAMILIES if varies and (positive or f.takes_zero)]
    found = []
    for k, family in enumerate(suiting):
        progress(k, len(suiting))
        with suppress(ValidationError, ScenarioError):  # no scenario can say it
            found.append(fit_family(family, x, resamples=resamples, seed=seed))
    progress(len(suiting), len(suiting))
    return tuple(sorted(found, key=lambda c: (c.rejected, c.aicc)))


def section_model(section: Mapping[str, Any]) -> DurationModel:
    """Return the distribution of a section that reads no file."""
    return _SECTION.validate_python(dict(section)).located(Path())


def anderson_darling(cdf: Array) -> Array:
    """Return A**2 of each sample, shape (b,), from the distribution function at its values.

    Args:
        cdf: shape (b, n), each row rising.
    """
    n = cdf.shape[1]
    f = np.clip(cdf, 1e-15, 1 - 1e-15)
    weights = 2 * np.arange(1, n + 1) - 1
    sums = np.log(f) + np.log1p(-f[:, ::-1])
    return np.asarray(-n - (weights * sums).mean(axis=1))


def fit_family(family: Family, x: Array, *, resamples: int, seed: int) -> Candidate:
    """Fit one family to one sample and test it.

    Args:
        family: it must suit the sample.
        x: durations in rising order, shape (n,) [s].
        resamples: bootstrap samples.
        seed: of the bootstrap.
    """
    generator = np.random.default_rng(seed)
    n, k = len(x), len(family.parameters)
    theta = family.fit(x[None])
    section = family.section(theta[0])
    likelihood = float(family.log_density(x[None], theta).sum())
    observed = float(anderson_darling(family.cdf(x[None], theta))[0])
    model = section_model(section)
    as_great, rows = 0, max(1, _CELLS // n)
    for start in range(0, resamples, rows):
        count = min(rows, resamples - start)
        drawn = np.sort(model.ppf(generator.random((count, n))), axis=1)
        again = family.cdf(drawn, family.fit(drawn))
        as_great += int(np.sum(anderson_darling(again) >= observed))
    return Candidate(
        family=family,
        theta=theta[0],
        section=section,
        aicc=2 * k - 2 * likelihood + 2 * k * (k + 1) / (n - k - 1),
        anderson_darling=observed,
        p_value=(1 + as_great) / (1 + resamples),
    )
