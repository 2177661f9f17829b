"""Durations as they were measured."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from planning.errors import ScenarioError
from planning.tasks.task_graph import SKILLS
from planning.transforms import Array, readonly
from twin.durations.model import DurationModel, require


class Empirical:
    """Measured durations, each as likely as any other.

    Attributes:
        values_s: the durations in rising order, shape (n,), read-only [s].
    """

    def __init__(self, values_s: npt.ArrayLike) -> None:
        """Keep durations [s]; ScenarioError when there are none or one is negative."""
        self.values_s = readonly(np.sort(np.ravel(np.asarray(values_s, dtype=float))))
        require(len(self.values_s) > 0, "empirical: no durations")
        require(
            bool(np.all(np.isfinite(self.values_s))) and self.values_s[0] >= 0,
            "empirical: durations must be finite and at least 0",
        )

    @classmethod
    def from_csv(cls, path: Path, column: str = "duration_s") -> Empirical:
        """Read the durations [s] in one column of a CSV file with a header line.

        Raises:
            ScenarioError: the file cannot be read, has no such column or no rows, or a value
                is not a finite number of at least 0; the message names file and line.
        """
        return cls([value for _, value in read_durations(path, column)])

    def ppf(self, u: Array) -> Array:
        """Return the quantiles [s]: the inverse of the empirical distribution function."""
        n = len(self.values_s)
        index = np.floor(np.asarray(u) * n).astype(np.int64)
        return self.values_s[np.minimum(index, n - 1)]

    @property
    def mean(self) -> float:
        """Expected duration [s]."""
        return float(np.mean(self.values_s))

    @property
    def sd(self) -> float:
        """Standard deviation of the distribution (not the estimate from a sample) [s]."""
        return float(np.std(self.values_s))

    @property
    def minimum(self) -> float:
        """Shortest duration [s]."""
        return float(self.values_s[0])


def read_durations(
    path: Path, column: str, labels: Sequence[str] = ()
) -> list[tuple[tuple[str, ...], float]]:
    """Read durations [s] and what labels them from a CSV file with a header line.

    Args:
        path: the file.
        column: of the durations.
        labels: columns of labels.

    Returns:
        For each row its labels and its duration.

    Raises:
        ScenarioError: the file cannot be read, lacks a column or has no rows, or a value is
            not a finite number of at least 0; the message names file and line.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.DictReader(file)
            names = tuple(reader.fieldnames or ())
            for name in (column, *labels):
                if name not in names:
                    raise ScenarioError(f"{path}: no column {name!r}", choices=names)
            rows = [
                (
                    tuple((row[name] or "").strip() for name in labels),
                    _duration_in_cell(path, reader.line_num, column, row[column]),
                )
                for row in reader
            ]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ScenarioError(f"{path}: cannot read durations: {error}") from error
    if not rows:
        raise ScenarioError(f"{path}: column {column!r} has no rows")
    return rows


def _duration_in_cell(path: Path, line: int, column: str, text: str | None) -> float:
    try:
        value = float(text or "")
    except ValueError:
        value = np.nan
    if not 0 <= value < np.inf:
        raise ScenarioError(
            f"{path}:{line}: {column} is {text!r}, not a duration of at least 0 s"
        )
    return value


def packaged_timings() -> dict[str, DurationModel]:
    """Return the synthetic LEGO timings that ship with the package, one model a skill."""
    return {skill: packaged_timing(skill) for skill in SKILLS}


@cache
def packaged_timing(skill: str) -> Empirical:
    """Return the synthetic timings of one skill; read once, for they never change."""
    folder = Path(__file__).parent / "packaged"
    return Empirical.from_csv(folder / f"{skill}.csv")
