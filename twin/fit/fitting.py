"""Fits of several samples, and where their results go."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from planning.errors import OutputError
from twin.durations.fittable import rounded
from twin.fit.samples import Sample
from twin.fit.selection import Candidate, fit_candidates
from twin.host.progress import Report, of_stage, report_nothing
from twin.run.folder import prepare_run_folder


@dataclass(frozen=True)
class Fit:
    """A sample and the distributions fitted to it.

    Attributes:
        sample: the durations.
        candidates: best first; none where all durations are as good as the same.
    """

    sample: Sample
    candidates: tuple[Candidate, ...]

    @property
    def best(self) -> Candidate | None:
        """The best candidate, None where the test rejects all of them."""
        if self.candidates and not self.candidates[0].rejected:
            return self.candidates[0]
        return None

    @property
    def csv(self) -> str:
        """Name of the file of the durations themselves, where nothing fits."""
        return f"{self.sample.name}.csv"

    @property
    def section(self) -> Mapping[str, Any]:
        """Section for a scenario: the best fit, or the measured times themselves."""
        if not self.candidates:
            return {
                "kind": "fixed",
                "value_s": rounded(np.median(self.sample.values_s)),
            }
        if self.best is None:
            return {"kind": "empirical", "csv": self.csv}
        return self.best.section


def fit_samples(
    samples: Sequence[Sample],
    *,
    resamples: int,
    seed: int = 0,
    progress: Report = report_nothing,
) -> tuple[Fit, ...]:
    """Fit every family to every sample.

    Args:
        samples: one a group.
        resamples: bootstrap samples of each test.
        seed: of the bootstrap.
        progress: told how far each group has come.
    """
    fits = []
    for sample in samples:
        found = fit_candidates(
            sample.values_s,
            resamples=resamples,
            seed=seed,
            progress=of_stage(progress, sample.name),
        )
        fits.append(Fit(sample, found))
    return tuple(fits)


def results_folder(out: Path | None, name: str) -> Path:
    """Make the folder for the results of a fit and return it.

    Args:
        out: the folder, whose other files stay; by default ``logs/fit-<name>-<UTC time>``.
        name: of what is fitted.

    Raises:
        OutputError: it cannot be made.
    """
    if out is None:
        return prepare_run_folder(None, f"fit-{name}")
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{out}: cannot be written to: {error}") from error
    return out
