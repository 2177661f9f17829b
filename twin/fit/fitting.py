"""Fits of several samples, and where their results go."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from planning.errors import OutputError
from twin.fit.samples import Sample
from twin.fit.selection import fit_candidates
from twin.fit.snippet import Fit
from twin.host.progress import Report, of_stage, report_nothing
from twin.run.folder import prepare_run_folder


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
