"""Empirical distributions of durations: measured values, each with the same probability."""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import cache, cached_property
from pathlib import Path
from typing import Annotated, Literal, get_args

import numpy as np
from pydantic import Field

from planning.errors import ScenarioError
from planning.files import is_file
from planning.transforms import Array, read_only_copy
from twin.durations.model import DurationModel, PackagedSkill
from twin.durations.timing_files import Unit, read_durations


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


class MeasuredTimes(_Sample):
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
        return read_only_copy(np.sort(self.values))

    # The sorted array is excluded from comparison: arrays have no single truth value.
    def __eq__(self, other: object) -> bool:
        if not isinstance(other, MeasuredTimes):
            return NotImplemented
        return (self.values, self.scale) == (other.values, other.scale)

    def __hash__(self) -> int:
        return hash((self.values, self.scale))


class Empirical(_Sample):
    """Drawn from measured times: a column of a CSV file, relative to the scenario file.

    Attributes:
        csv: path of the file, relative to that of the scenario.
        column: its column with the durations, whose name may end with their unit.
        unit: of the durations where the column's name has none; seconds by default.
    """

    kind: Literal["empirical"] = "empirical"
    csv: str
    column: str = "duration_s"
    unit: Unit | None = None

    def _located(self, folder: Path) -> MeasuredTimes:
        """Return the durations of the file; ScenarioError names file and line."""
        path = folder / self.csv
        if not is_file(path):
            raise ScenarioError(f"no such file: {path}")
        rows = read_durations(path, self.column, unit=self.unit)
        return MeasuredTimes(values=tuple(value for _, value in rows), scale=self.scale)

    @property
    def values_s(self) -> Array:
        """The durations of the file, where its path is relative to the current folder [s]."""
        return self._located(Path()).values_s


class Packaged(_Sample):
    """Drawn from the synthetic timings that ship with the package, those of a skill.

    Attributes:
        skill: whose timings.
    """

    kind: Literal["packaged"] = "packaged"
    skill: PackagedSkill

    @property
    def values_s(self) -> Array:
        """The durations in rising order, shape (n,), read-only [s]."""
        return _packaged_values(self.skill)


def packaged_timings() -> dict[str, DurationModel]:
    """Return the synthetic LEGO timings that ship with the package, one model a skill."""
    return {skill: Packaged(skill=skill) for skill in get_args(PackagedSkill)}


@cache
def _packaged_values(skill: str) -> Array:
    path = Path(__file__).parent / "packaged" / f"{skill}.csv"
    return read_only_copy(
        np.sort([value for _, value in read_durations(path, "duration_s")])
    )
