"""Empirical distributions of measured durations, and their CSV files."""

from __future__ import annotations

import csv
import io
import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import cache, cached_property
from pathlib import Path
from typing import Annotated, Literal, get_args

import numpy as np
from pydantic import Field

from planning.errors import ScenarioError
from planning.files import is_file, read_file
from planning.transforms import Array, readonly
from twin.durations.model import DurationModel, Skill


class _Sample(DurationModel, ABC):
    """Some durations, each as likely as any other."""

    @property
    @abstractmethod
    def values_s(self) -> Array:
        """The durations in rising order, shape (n,), read-only [s]."""

    def _ppf(self, u: Array) -> Array:
        """Return the inverse of the empirical distribution function."""
        n = len(self.values_s)
        index = np.floor(np.asarray(u) * n).astype(np.int64)
        return self.values_s[np.minimum(index, n - 1)]

    def _mean(self) -> float:
        return float(np.mean(self.values_s))

    def _minimum(self) -> float:
        return float(self.values_s[0])


class Measured(_Sample):
    """Empirical distribution of given durations.

    Attributes:
        values: the durations [s].
    """

    values: Annotated[
        tuple[Annotated[float, Field(ge=0)], ...], Field(min_length=1, repr=False)
    ]

    @cached_property
    def values_s(self) -> Array:
        """The durations in rising order, shape (n,), read-only [s]."""
        return readonly(np.sort(self.values))

    # The sorted array is no part of what is compared: arrays have no one truth value.
    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Measured):
            return NotImplemented
        return (self.values, self.scale) == (other.values, other.scale)

    def __hash__(self) -> int:
        return hash((self.values, self.scale))


class Empirical(_Sample):
    """Drawn from measured times: a column of a CSV file, relative to the scenario file."""

    kind: Literal["empirical"] = "empirical"
    csv: str
    column: str = "duration_s"

    def located(self, folder: Path) -> Measured:
        """Return the durations of the file; ScenarioError names file and line."""
        path = folder / self.csv
        if not is_file(path):
            raise ScenarioError(f"no such file: {path}")
        rows = read_durations(path, self.column)
        return Measured(values=tuple(value for _, value in rows), scale=self.scale)

    @property
    def values_s(self) -> Array:
        """The durations of the file, where its path is relative to the current folder [s]."""
        return self.located(Path()).values_s


class Packaged(_Sample):
    """Drawn from the synthetic timings that ship with the package, those of a skill."""

    kind: Literal["packaged"] = "packaged"
    skill: Skill

    @property
    def values_s(self) -> Array:
        """The durations in rising order, shape (n,), read-only [s]."""
        return _packaged_values(self.skill)


def packaged_timings() -> dict[str, DurationModel]:
    """Return the synthetic LEGO timings that ship with the package, one model a skill."""
    return {skill: Packaged(skill=skill) for skill in get_args(Skill)}


@cache
def _packaged_values(skill: str) -> Array:
    path = Path(__file__).parent / "packaged" / f"{skill}.csv"
    return readonly(np.sort([value for _, value in read_durations(path, "duration_s")]))


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
        reader = csv_rows(path)
        names = tuple(reader.fieldnames or ())
        for name in (column, *labels):
            if name not in names:
                raise ScenarioError(
                    f"{path}: no column {name!r}",
                    choices=tuple(n[:40] for n in names[:20]),
                )
        rows = [
            (
                tuple((row[name] or "").strip() for name in labels),
                _duration_in_cell(path, reader.line_num, column, row[column]),
            )
            for row in reader
        ]
    except csv.Error as error:
        raise ScenarioError(f"{path}: is no CSV file: {error}") from error
    if not rows:
        raise ScenarioError(f"{path}: column {column!r} has no rows")
    return rows


def csv_rows(path: Path) -> csv.DictReader[str]:
    """Return a reader of a CSV file with a header line.

    Raises:
        ScenarioError: it cannot be read.
    """
    try:
        text = read_file(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ScenarioError(f"{path}: not UTF-8 (byte {error.start})") from None
    except OSError as error:
        raise ScenarioError(
            f"{path}: cannot read durations: {error.strerror}"
        ) from None
    return csv.DictReader(io.StringIO(text, newline=""))


def _duration_in_cell(path: Path, line: int, column: str, text: str | None) -> float:
    try:
        value = float(text or "")
    except ValueError:
        value = math.nan
    if not 0 <= value < math.inf:
        raise ScenarioError(
            f"{path}:{line}: {column} is {text!r}, not a duration of at least 0 s"
        )
    return value
