"""Measured durations in groups: one sample a skill, robot or type of object."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from planning.errors import ScenarioError
from planning.tasks.task import SKILLS
from planning.transforms import Array, readonly
from twin.durations.measured import csv_rows, read_durations

LABELS = ("skill", "robot", "object")
"""Columns that can tell groups apart."""

FEWEST = 10
"""Fewer durations say too little to tell distributions apart."""


@dataclass(frozen=True)
class Sample:
    """Durations that belong together.

    Attributes:
        labels: skill, robot and object, as far as known.
        values_s: the durations in the order of the file, shape (n,) [s].
    """

    labels: Mapping[str, str]
    values_s: Array

    @property
    def name(self) -> str:
        """Name of the group that can be that of a file."""
        text = "-".join(self.labels.values()) or "durations"
        return "".join(c if c.isalnum() or c in "._-" else "_" for c in text)


def read_samples(
    path: Path,
    *,
    column: str = "duration_s",
    by: Sequence[str] = (),
    skill: str | None = None,
) -> tuple[Sample, ...]:
    """Read a CSV file of measured durations, group by group.

    Args:
        path: the file, with a header line.
        column: of the durations [s].
        by: columns whose values make the groups, names from LABELS.
        skill: what all rows are of where no column says it; by default the name of the file
            where it is that of a skill.

    Returns:
        The samples in the order in which the groups first occur.

    Raises:
        ScenarioError: as by read_durations; or an unknown group column, an unknown skill, a
            group for a robot or an object without a skill, or a group of too few durations.
    """
    for name in by:
        if name not in LABELS:
            raise ScenarioError(f"cannot group by {name!r}", choices=LABELS)
    if skill is not None and skill not in SKILLS:
        raise ScenarioError(f"no skill {skill!r}", choices=SKILLS)
    if skill is None and path.stem in SKILLS:
        skill = path.stem
    keys = tuple(dict.fromkeys(by))
    if keys and "skill" not in keys and skill is None:
        raise ScenarioError(
            f"{path}: of which skill are these? Say --skill, or --by skill",
            choices=SKILLS,
        )
    groups: dict[tuple[str, ...], list[float]] = {}
    for labels, value in read_durations(path, column, keys):
        groups.setdefault(labels, []).append(value)
    return tuple(
        _sample(path, dict(zip(keys, labels, strict=True)), skill, values)
        for labels, values in groups.items()
    )


def _sample(
    path: Path, labels: dict[str, str], skill: str | None, values: list[float]
) -> Sample:
    if "skill" not in labels and skill is not None:
        labels = {"skill": skill, **labels}
    where = (
        f"{path}: {', '.join(f'{k} {v!r}' for k, v in labels.items()) or 'the file'}"
    )
    if "skill" in labels and labels["skill"] not in SKILLS:
        raise ScenarioError(f"{where} is no skill", choices=SKILLS)
    for name, label in labels.items():
        if not label:
            raise ScenarioError(f"{path}: a row has no {name}")
    if len(values) < FEWEST:
        raise ScenarioError(
            f"{where} has {len(values)} durations; at least {FEWEST} are needed to tell"
            " distributions apart"
        )
    ordered = {name: labels[name] for name in LABELS if name in labels}
    return Sample(ordered, readonly(values))


def unused_labels(path: Path, by: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Return the values of the columns that tell groups apart and were not asked to.

    Args:
        path: a file that read_samples has read.
        by: what was asked for.
    """
    rows = list(csv_rows(path))
    out = {}
    for name in LABELS:
        values = tuple(dict.fromkeys(row.get(name) or "" for row in rows))
        if name not in by and len(values) > 1:
            out[name] = values
    return out
