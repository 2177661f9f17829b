"""Measured durations in groups: one sample a skill, robot or type of object."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from planning.errors import ScenarioError
from planning.tasks.task import SKILLS, STRAIGHT, TRANSIT
from planning.transforms import Array, readonly
from twin.durations.measured import Columns, csv_rows, read_durations
from twin.fit.logged_skills import is_log, logged_skills
from twin.scenario.document.section import NAME

LABELS = ("skill", "robot", "object")
"""Columns that can tell groups apart."""

FEWEST = 10
"""Fewer durations say too little to tell distributions apart."""

DURATION = "duration_s"
"""Column of durations where none is named."""

_STAMPS = (
    ("start", "end"),
    ("start_s", "end_s"),
    ("start_time", "end_time"),
    ("started", "completed"),
)
"""Columns of time stamps that are understood where there is no column of durations."""

_Rows = Iterator[tuple[tuple[str, ...], float]]


@dataclass(frozen=True)
class FitSample:
    """Durations that belong together.

    Attributes:
        labels: skill, robot and object, as far as known.
        values_s: the durations in the order of the files, shape (n,) [s].
    """

    labels: Mapping[str, str]
    values_s: Array

    @property
    def name(self) -> str:
        """Name of the group that can be that of a file."""
        text = "-".join(self.labels.values()) or "durations"
        return "".join(c if c.isalnum() or c in "._-" else "_" for c in text)


def read_samples(
    paths: Sequence[Path],
    *,
    columns: Columns | None = None,
    by: Sequence[str] = (),
    skill: str | None = None,
) -> tuple[tuple[FitSample, ...], dict[str, int]]:
    """Read measured durations, group by group.

    Args:
        paths: CSV files with a header line, or event logs of runs: all of one kind.
        columns: of the durations [s] in CSV files, or of the stamps at which they start and end;
            by default ``duration_s``, or two that are named so.
        by: columns whose values make the groups, names from LABELS; in logs always by skill.
        skill: what all rows are of where no column says it; by default the name of the file
            where it is that of a skill.

    Returns:
        The samples in the order in which the groups first occur; and of logs, which hold what
        happened to happen, the groups that are too small, with the number of their durations.

    Raises:
        ScenarioError: as by read_durations; or an unknown group column, an unknown skill, a
            group for a robot or an object without a skill, or a group of too few durations.
        TwinError: as by logged_skills.
    """
    for name in by:
        if name not in LABELS:
            raise ScenarioError(f"cannot group by {name!r}", choices=LABELS)
    if skill is not None and not _is_skill(skill):
        raise ScenarioError(f"{skill!r} cannot be the name of a skill", choices=SKILLS)
    logs = [is_log(path) for path in paths]
    if any(logs) and not all(logs):
        raise ScenarioError("give CSV files or event logs, not both at once")
    keys = tuple(dict.fromkeys(("skill", *by) if any(logs) else by))
    if not any(logs):
        skill = skill or _skill_of_names(paths)
    if keys and "skill" not in keys and skill is None:
        raise ScenarioError(
            f"{paths[0]}: of which skill are these? Say --skill, or --by skill",
            choices=SKILLS,
        )
    groups: dict[tuple[str, ...], list[float]] = {}
    for path in paths:
        for labels, value in (
            _logged(path, keys, skill) if any(logs) else _rows(path, columns, keys)
        ):
            groups.setdefault(labels, []).append(value)
    left_out = {}
    if any(logs):
        few = {k: len(values) for k, values in groups.items() if len(values) < FEWEST}
        if len(few) < len(groups):
            left_out = {", ".join(filter(None, k)): count for k, count in few.items()}
            groups = {k: values for k, values in groups.items() if k not in few}
        if not groups:
            raise ScenarioError(f"{paths[0]}: no skill was completed")
    samples = tuple(
        _sample(paths[0], dict(zip(keys, labels, strict=True)), skill, values)
        for labels, values in groups.items()
    )
    return samples, left_out


def _is_skill(name: str) -> bool:
    """Tell whether a skill may have a name: a packaged one, or a process of a scenario."""
    return re.fullmatch(NAME, name) is not None and name not in (TRANSIT, STRAIGHT)


def _skill_of_names(paths: Sequence[Path]) -> str | None:
    """Return the skill that all files are named after, None where there is none."""
    names = {path.stem for path in paths}
    return names.pop() if len(names) == 1 and names <= set(SKILLS) else None


def _rows(path: Path, columns: Columns | None, keys: Sequence[str]) -> _Rows:
    if columns is None:
        names = csv_rows(path).fieldnames or ()
        found = [pair for pair in _STAMPS if set(pair) <= set(names)]
        columns = DURATION if DURATION in names or not found else found[0]
    yield from read_durations(path, columns, keys)


def _logged(path: Path, keys: Sequence[str], skill: str | None) -> _Rows:
    for entry in logged_skills(path):
        labels = {"skill": entry.skill, "robot": entry.robot, "object": entry.object}
        # Supports are done to nothing: there is no exception to make of them.
        known = all(labels[key] for key in keys)
        if known and skill in (None, entry.skill):
            yield tuple(labels[key] for key in keys), entry.seconds


def _sample(
    path: Path, labels: dict[str, str], skill: str | None, values: list[float]
) -> FitSample:
    if "skill" not in labels and skill is not None:
        labels = {"skill": skill, **labels}
    where = (
        f"{path}: {', '.join(f'{k} {v!r}' for k, v in labels.items()) or 'the file'}"
    )
    if "skill" in labels and not _is_skill(labels["skill"]):
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
    return FitSample(ordered, readonly(values))


def unused_labels(
    paths: Sequence[Path], by: Sequence[str]
) -> dict[str, tuple[str, ...]]:
    """Return the values of the columns that tell groups apart and were not asked to."""
    rows = [row for path in paths for row in csv_rows(path)]
    out = {}
    for name in LABELS:
        values = tuple(dict.fromkeys(row.get(name) or "" for row in rows))
        if name not in by and len(values) > 1:
            out[name] = values
    return out
