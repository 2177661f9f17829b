"""Fits of several samples, and the lines of a scenario file that draw durations so."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from twin.durations.fittable import rounded
from twin.fit.samples import Sample
from twin.fit.selection import Candidate
from twin.host.atomic import write_text
from twin.scenario.document.yaml_text import scenario_text


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
    def is_empirical(self) -> bool:
        """True if nothing fits, so that the durations themselves are drawn from."""
        return bool(self.candidates) and self.best is None

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

    def named(self, prefix: str) -> dict[str, Any]:
        """Return the section, with a prefix to the name of its file where it names one."""
        if self.is_empirical:
            return {**self.section, "csv": prefix + self.csv}
        return dict(self.section)


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
        content = {"duration": dict(fits[0].section)}
    text = scenario_text(content, "\n".join(note))
    write_text(folder / "durations.yaml", text)
    return text


def write_sample(path: Path, fit: Fit) -> None:
    """Write the durations that were fitted as a CSV file; OutputError if that fails."""
    lines = "".join(f"{value!r}\n" for value in fit.sample.values_s.tolist())
    write_text(path, f"duration_s\n{lines}")


def fitted_execution(fits: Sequence[Fit], *, prefix: str = "") -> dict[str, Any]:
    """Return the execution section of fits: ``skills`` and ``skill_overrides``.

    Args:
        fits: each of a skill.
        prefix: to the names of the files of durations that nothing fits.
    """
    skills, overrides = {}, []
    for fit in fits:
        labels = dict(fit.sample.labels)
        if set(labels) == {"skill"}:
            skills[labels["skill"]] = fit.named(prefix)
        else:
            overrides.append({**labels, "duration": fit.named(prefix)})
    out: dict[str, Any] = {}
    if skills:
        out["skills"] = skills
    if overrides:
        out["skill_overrides"] = overrides
    return out
