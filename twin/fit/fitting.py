"""Fits of several samples, and the lines of a scenario file that draw durations so."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from planning.errors import OutputError
from twin.durations.fittable import rounded
from twin.fit.samples import Sample
from twin.fit.selection import Candidate
from twin.host.atomic import write_text
from twin.run.folder import prepare_run_folder
from twin.scenario.document.text import scenario_text


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


def results_folder(out: Path | None, name: str) -> Path:
    """Make the folder for the results of a fit and return it; OutputError if that fails.

    Args:
        out: the folder, whose other files stay; by default ``logs/fit-<name>-<UTC time>``.
        name: of what is fitted.
    """
    if out is None:
        return prepare_run_folder(None, f"fit-{name}")
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{out}: cannot be written to: {error}") from error
    return out


def write_snippet(folder: Path, fits: Sequence[Fit], source: str) -> str:
    """Write ``durations.yaml``, and the durations of each sample that nothing fits.

    Args:
        folder: where.
        fits: of one file.
        source: name of that file, for the comment on top.

    Returns:
        The lines of a scenario, with a comment that says where they come from.

    Raises:
        OutputError: a file cannot be written.
    """
    count = sum(len(fit.sample.values_s) for fit in fits)
    note = [f"{count} durations of {source}, fitted by: twin fit"]
    empirical = [fit for fit in fits if fit.section["kind"] == "empirical"]
    for fit in empirical:
        lines = "".join(f"{value!r}\n" for value in fit.sample.values_s.tolist())
        write_text(folder / fit.csv, f"duration_s\n{lines}")
    if empirical:
        names = ", ".join(fit.csv for fit in empirical)
        note.append(f"No distribution fits {names}: copy beside the scenario.")
    content: dict[str, Any] = {"execution": _execution(fits)}
    if not any(fit.sample.labels for fit in fits):
        note.append("Put it wherever a scenario takes a duration.")
        content = {"duration": dict(fits[0].section)}
    text = scenario_text(content, "\n".join(note))
    write_text(folder / "durations.yaml", text)
    return text


def _execution(fits: Sequence[Fit]) -> dict[str, Any]:
    skills, overrides = {}, []
    for fit in fits:
        labels = dict(fit.sample.labels)
        if set(labels) == {"skill"}:
            skills[labels["skill"]] = dict(fit.section)
        else:
            overrides.append({**labels, "duration": dict(fit.section)})
    out: dict[str, Any] = {}
    if skills:
        out["skills"] = skills
    if overrides:
        out["skill_overrides"] = overrides
    return out
