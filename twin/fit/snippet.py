"""Lines of a scenario file that draw durations as a fit found them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from twin.fit.fitting import Fit
from twin.host.atomic import write_text
from twin.scenario.document.text import scenario_text


def write_snippet(folder: Path, fits: Sequence[Fit], source: str) -> None:
    """Write ``durations.yaml``, and the durations of each sample that nothing fits.

    Args:
        folder: where.
        fits: of one file.
        source: name of that file, for the comment on top.

    Raises:
        OutputError: a file cannot be written.
    """
    for fit in fits:
        if fit.candidates and fit.best is None:
            lines = "".join(f"{value!r}\n" for value in fit.sample.values_s.tolist())
            write_text(folder / fit.csv, f"duration_s\n{lines}")
    write_text(folder / "durations.yaml", snippet(fits, source))


def snippet(fits: Sequence[Fit], source: str) -> str:
    """Return the lines of a scenario, with a comment that says where they come from."""
    count = sum(len(fit.sample.values_s) for fit in fits)
    note = [f"{count} durations of {source}, fitted by: twin fit"]
    empirical = [fit.csv for fit in fits if fit.section["kind"] == "empirical"]
    if empirical:
        note.append(
            f"No distribution fits {', '.join(empirical)}: copy beside the scenario."
        )
    content: dict[str, Any]
    if not any(fit.sample.labels for fit in fits):
        note.append("Put it wherever a scenario takes a duration.")
        content = {"duration": dict(fits[0].section)}
    else:
        content = {"execution": _execution(fits)}
    return scenario_text(content, "\n".join(note))


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
