"""Fits of several samples, and the lines of a scenario file that draw durations so.

Candidate distributions of one sample: fitted, tested and ranked.

Picture of a fit: histogram with densities, and quantiles against quantiles.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from pydantic import TypeAdapter, ValidationError

from planning.errors import ScenarioError
from planning.progress import Progress, no_progress
from planning.transforms import Array
from twin.document.yaml_text import scenario_text
from twin.durations.bounded import Pert, Triangular, Uniform
from twin.durations.fittable import Family, ShiftedFamily, rounded
from twin.durations.lifetimes import AnyDuration, Exponential, Gamma, Weibull
from twin.durations.model import DurationModel
from twin.durations.normal import Lognormal, TruncatedNormal
from twin.fit.samples import FitSample
from twin.host.guard import write_text
from twin.host.pictures import INK, new_picture, save_png, style_axes

FAMILIES: tuple[Family, ...] = (
    Uniform,
    Triangular,
    Pert,
    TruncatedNormal,
    Exponential,
    Lognormal,
    Gamma,
    Weibull,
    ShiftedFamily(Exponential),
    ShiftedFamily(Lognormal),
    ShiftedFamily(Gamma),
    ShiftedFamily(Weibull),
)
"""Families that are fitted."""

LEVEL = 0.05
"""A family is rejected where the probability of a fit as bad is less."""

_CELLS = 200_000
"""Values of resamples that are fitted at once: it bounds the memory."""

_LEAST_SPREAD = 1e-4
"""Samples whose range is a smaller share of their greatest value do not vary."""

_SECTION: TypeAdapter[DurationModel] = TypeAdapter(AnyDuration)


@dataclass(frozen=True)
class Candidate:
    """A family fitted to a sample.

    Attributes:
        family: the family.
        theta: its parameters, shape (p,).
        section: the same as a scenario says it.
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
        progress: told how many families are done.

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


@dataclass(frozen=True)
class Fit:
    """A sample and the distributions fitted to it.

    Attributes:
        sample: the durations.
        candidates: best first; none where all durations are as good as the same.
    """

    sample: FitSample
    candidates: tuple[Candidate, ...]

    @property
    def best(self) -> Candidate | None:
        """The best candidate, None where the test rejects all of them."""
        if self.candidates and not self.candidates[0].rejected:
            return self.candidates[0]
        return None

    @property
    def is_empirical(self) -> bool:
        """True if nothing fits, so that the durations themselves are drawn from."""
        return bool(self.candidates) and self.best is None

    @property
    def csv(self) -> str:
        """Name of the file of the durations themselves, where nothing fits."""
        return f"{self.sample.name}.csv"

    def section(self, prefix: str = "") -> dict[str, Any]:
        """Return the section for a scenario: the best fit, or the measured times in a file with a prefix."""
        if not self.candidates:
            median = rounded(np.median(self.sample.values_s))
            return {"kind": "fixed", "value_s": median}
        if self.best is None:
            return {"kind": "empirical", "csv": prefix + self.csv}
        return dict(self.best.section)


def write_snippet(folder: Path, fits: Sequence[Fit], source: str) -> str:
    """Write ``durations.yaml``, and the durations of each sample that nothing fits.

    Args:
        folder: where.
        fits: of one file.
        source: how many there are and where they come from, for the comment on top.

    Returns:
        The lines of a scenario, with a comment that says where they come from.

    Raises:
        OutputError: a file cannot be written.
    """
    note = [source]
    empirical = [fit for fit in fits if fit.is_empirical]
    for fit in empirical:
        write_sample(folder / fit.csv, fit)
    if empirical:
        names = ", ".join(fit.csv for fit in empirical)
        note.append(f"No distribution fits {names}: copy beside the scenario.")
    content: dict[str, Any] = {"execution": fitted_execution(fits)}
    if not any(fit.sample.labels for fit in fits):
        note.append("Put it wherever a scenario takes a duration.")
        content = {"duration": fits[0].section()}
    text = scenario_text(content, "\n".join(note))
    write_text(folder / "durations.yaml", text)
    return text


def write_sample(path: Path, fit: Fit) -> None:
    """Write the durations that were fitted as a CSV file; OutputError if that fails."""
    lines = "".join(f"{value!r}\n" for value in fit.sample.values_s.tolist())
    write_text(path, f"duration_s\n{lines}")


def fitted_execution(fits: Sequence[Fit], *, prefix: str = "") -> dict[str, Any]:
    """Return the execution section of fits: ``skills`` and ``skill_overrides``."""
    skills, overrides = {}, []
    for fit in fits:
        labels = dict(fit.sample.labels)
        if set(labels) == {"skill"}:
            skills[labels["skill"]] = fit.section(prefix)
        else:
            overrides.append({**labels, "duration": fit.section(prefix)})
    out = {"skills": skills, "skill_overrides": overrides}
    return {key: value for key, value in out.items() if value}


_BARS = "#c9d3de"
_COLOURS = ("#1f5f9e", "#d97b29", "#2f7f66")
_SHOWN = len(_COLOURS)


def draw_fit(path: Path, fit: Fit) -> None:
    """Draw a sample and its best candidates as a PNG picture.

    Left: the durations, and the densities of the best three. Right: quantiles of the same
    distributions against those of the sample; a distribution that fits is on the line.

    Args:
        path: of the picture, replaced when it exists.
        fit: what to draw.

    Raises:
        OutputError: the picture cannot be written.
    """
    picture = new_picture(11.0, 4.8)
    left, right = picture.subplots(1, 2)
    values = np.sort(fit.sample.values_s)
    _histogram(left, values, fit.candidates[:_SHOWN])
    _quantiles(right, values, fit.candidates[:_SHOWN])
    labels = fit.sample.labels
    title = ", ".join(labels.values()) if labels else "durations"
    picture.suptitle(
        f"{title}: {len(values)} durations, {_verdict(fit)}", color=INK, fontsize=12
    )
    save_png(picture, path)


def _verdict(fit: Fit) -> str:
    if not fit.candidates:
        return "all the same"
    if fit.best is None:
        return "no distribution fits: use them as they are"
    return f"best fit {fit.best.family.title}"


def _histogram(axes: Axes, values: Array, candidates: tuple[Candidate, ...]) -> None:
    spread = values[-1] - values[0]
    bins = np.histogram_bin_edges(values, "auto" if spread > 0 else 1)
    if len(bins) > 60:
        bins = np.histogram_bin_edges(values, 60)
    axes.hist(values, bins=bins.tolist(), density=True, color=_BARS, label="measured")
    margin = 0.25 * spread
    t = np.linspace(max(values[0] - margin, 0.0), values[-1] + margin, 600)
    tallest = axes.get_ylim()[1]
    for candidate, colour in zip(candidates, _COLOURS, strict=False):
        log = candidate.family.log_density(t[None], candidate.theta[None])[0]
        axes.plot(t, np.exp(log), color=colour, label=_legend(candidate), linewidth=1.8)
        tallest = max(tallest, 1.1 * float(np.exp(np.percentile(log, 99))))
    axes.plot(values, np.zeros_like(values), "|", color=INK, markersize=9, alpha=0.5)
    # A density may rise without bound where its support begins.
    axes.set_ylim(0, min(tallest, 3 * axes.get_ylim()[1]))
    axes.set_xlabel("duration [s]")
    axes.set_ylabel("density [1/s]")
    axes.legend(frameon=False, fontsize=8)
    style_axes(axes)


def _quantiles(axes: Axes, values: Array, candidates: tuple[Candidate, ...]) -> None:
    u = (np.arange(len(values)) + 0.5) / len(values)
    axes.axline((values[0], values[0]), slope=1, color=INK, linewidth=1.0)
    for candidate, colour in zip(candidates, _COLOURS, strict=False):
        axes.plot(
            *(candidate.model.ppf(u), values, "o"),
            color=colour,
            markersize=3.5,
            alpha=0.8,
            label=candidate.family.title,
        )
    axes.set_xlabel("quantile of the distribution [s]")
    axes.set_ylabel("quantile measured [s]")
    if candidates:
        axes.legend(frameon=False, fontsize=8, loc="upper left")
    axes.set_aspect("equal", adjustable="datalim")
    style_axes(axes)


def _legend(candidate: Candidate) -> str:
    verdict = ", rejected" if candidate.rejected else ""
    return f"{candidate.family.title} (p = {candidate.p_value:.2g}{verdict})"
