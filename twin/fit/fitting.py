"""Fits of distributions to several samples of durations, and the scenario text with the results."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from twin.document.yaml_text import scenario_text
from twin.durations.fittable import round_parameter
from twin.fit.candidates import Candidate
from twin.fit.samples import FitSample
from twin.host.atomic_files import write_text


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
        """True if nothing fits and the empirical distribution is used."""
        return bool(self.candidates) and self.best is None

    @property
    def csv(self) -> str:
        """Name of the file of measured durations, where nothing fits."""
        return f"{self.sample.name}.csv"

    def section(self, prefix: str = "") -> dict[str, Any]:
        """Return the section for a scenario: the best fit, or the measured times in a file with a prefix."""
        if not self.candidates:
            median = round_parameter(np.median(self.sample.values_s))
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
        The lines of a scenario, with a comment on their source.

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
    """Write the durations of a sample as a CSV file; OutputError if that fails."""
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
