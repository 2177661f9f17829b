"""How long skills take: duration models, and the durations they give the nodes of a TPG."""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
import numpy.typing as npt
from scipy.special import ndtri

from planning.errors import ScenarioError
from planning.task_graph import SKILLS
from planning.transforms import Array, readonly
from scheduling.temporal_plan_graph import NodeChain, TemporalPlanGraph
from twin.draws import uniforms

Nanoseconds = npt.NDArray[np.int64]
"""Times or durations [ns]."""

NANOSECONDS = 1_000_000_000
"""Nanoseconds in a second."""

_Z95 = float(ndtri(0.95))


class DurationModel(Protocol):
    """A distribution of durations, given by its quantile function."""

    def ppf(self, u: Array) -> Array:
        """Return the quantiles [s] of probabilities ``u`` in (0, 1), same shape."""
        ...

    @property
    def mean(self) -> float:
        """Expected duration [s]."""
        ...


def _require(holds: bool, message: str) -> None:
    if not holds:
        raise ScenarioError(message)


@dataclass(frozen=True)
class Fixed:
    """Always the same duration.

    Attributes:
        value_s: the duration [s].
    """

    value_s: float

    def __post_init__(self) -> None:
        _require(0 <= self.value_s < np.inf, f"fixed: value_s {self.value_s} < 0")

    def ppf(self, u: Array) -> Array:
        """Return ``value_s`` for every probability."""
        return np.full(np.shape(u), self.value_s)

    @property
    def mean(self) -> float:
        """Expected duration [s]."""
        return self.value_s


@dataclass(frozen=True)
class Uniform:
    """Anything between two bounds, equally likely.

    Attributes:
        low_s, high_s: the bounds [s].
    """

    low_s: float
    high_s: float

    def __post_init__(self) -> None:
        _require(
            0 <= self.low_s <= self.high_s < np.inf,
            f"uniform: need 0 <= low_s <= high_s, not {self.low_s} and {self.high_s}",
        )

    def ppf(self, u: Array) -> Array:
        """Return the quantiles [s] of probabilities ``u``."""
        return self.low_s + np.asarray(u) * (self.high_s - self.low_s)

    @property
    def mean(self) -> float:
        """Expected duration [s]."""
        return 0.5 * (self.low_s + self.high_s)


@dataclass(frozen=True)
class Lognormal:
    """Skewed to long durations; its logarithm is normal.

    Attributes:
        median_s: half of the durations are shorter [s].
        p95_s: 95 % of the durations are shorter [s].
    """

    median_s: float
    p95_s: float

    def __post_init__(self) -> None:
        _require(
            0 < self.median_s <= self.p95_s < np.inf,
            f"lognormal: need 0 < median_s <= p95_s, "
            f"not {self.median_s} and {self.p95_s}",
        )

    @property
    def sigma(self) -> float:
        """Standard deviation of the logarithm of the duration in seconds."""
        return float(np.log(self.p95_s / self.median_s)) / _Z95

    def ppf(self, u: Array) -> Array:
        """Return the quantiles [s] of probabilities ``u``."""
        return self.median_s * np.exp(self.sigma * ndtri(np.asarray(u)))

    @property
    def mean(self) -> float:
        """Expected duration [s]."""
        return self.median_s * float(np.exp(0.5 * self.sigma**2))


class Empirical:
    """Measured durations, each as likely as any other.

    Attributes:
        values_s: the durations in rising order, shape (n,), read-only [s].
    """

    def __init__(self, values_s: npt.ArrayLike) -> None:
        """Keep durations [s]; ScenarioError when there are none or one is negative."""
        self.values_s = readonly(np.sort(np.ravel(np.asarray(values_s, dtype=float))))
        _require(len(self.values_s) > 0, "empirical: no durations")
        _require(
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
        try:
            with path.open(newline="", encoding="utf-8") as file:
                reader = csv.DictReader(file)
                names = tuple(reader.fieldnames or ())
                if column not in names:
                    raise ScenarioError(f"{path}: no column {column!r}", choices=names)
                values = [
                    _duration_in_cell(path, reader.line_num, column, row[column])
                    for row in reader
                ]
        except (OSError, UnicodeDecodeError, csv.Error) as error:
            raise ScenarioError(f"{path}: cannot read durations: {error}") from error
        if not values:
            raise ScenarioError(f"{path}: column {column!r} has no rows")
        return cls(values)

    def ppf(self, u: Array) -> Array:
        """Return the quantiles [s]: the inverse of the empirical distribution function."""
        n = len(self.values_s)
        index = np.floor(np.asarray(u) * n).astype(np.int64)
        return self.values_s[np.minimum(index, n - 1)]

    @property
    def mean(self) -> float:
        """Expected duration [s]."""
        return float(np.mean(self.values_s))


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
    folder = Path(__file__).parent / "timings"
    return {skill: Empirical.from_csv(folder / f"{skill}.csv") for skill in SKILLS}


def to_nanoseconds(seconds: npt.ArrayLike) -> Nanoseconds:
    """Return times in whole nanoseconds, rounded to the nearest."""
    exact = np.asarray(seconds, dtype=float) * NANOSECONDS
    return np.asarray(np.rint(exact), dtype=np.int64)


class NodeDurations(Protocol):
    """What gives every node of a TPG its duration in one replication."""

    def sample(
        self, tpg: TemporalPlanGraph, *, seed: int, replication: int = 0
    ) -> tuple[Nanoseconds, ...]:
        """Return durations per chain, each of shape (nodes,) [ns]."""
        ...


@dataclass(frozen=True)
class SkillDurations:
    """Skills vary, motions take their nominal time.

    A duration belongs to the task, not to the run: the same task has the same draw under every
    policy and however its nodes were cut.

    Attributes:
        models: duration model of each skill; a skill without one keeps its nominal duration.
    """

    models: Mapping[str, DurationModel]

    def sample(
        self, tpg: TemporalPlanGraph, *, seed: int, replication: int = 0
    ) -> tuple[Nanoseconds, ...]:
        """Return durations per chain, each of shape (nodes,) [ns]."""
        return tuple(
            self._sample_chain(tpg, chain, seed, replication) for chain in tpg.chains
        )

    def _sample_chain(
        self, tpg: TemporalPlanGraph, chain: NodeChain, seed: int, replication: int
    ) -> Nanoseconds:
        out = to_nanoseconds(chain.duration)
        nodes = np.flatnonzero(chain.skill)
        by_skill: dict[str, list[int]] = {}
        for task in dict.fromkeys(chain.task[nodes].tolist()):
            if tpg.tasks[task].kind in self.models:
                by_skill.setdefault(tpg.tasks[task].kind, []).append(task)
        for skill, tasks in by_skill.items():
            count = len(tasks)
            u = uniforms(
                seed,
                replication,
                [chain.robot] * count,
                tasks,
                [skill] * count,
                "duration",
            )
            totals = to_nanoseconds(self.models[skill].ppf(u)).tolist()
            for task, total in zip(tasks, totals, strict=True):
                low, high = np.searchsorted(chain.task, (task, task + 1))
                own = np.arange(low, high)[chain.skill[low:high]]
                out[own] = _share(total, chain.duration[own])
        return out


def _share(total: int, weights: Array) -> Nanoseconds:
    """Split a whole number in proportion to weights; the parts add up to it exactly."""
    if len(weights) == 1:
        return np.array([total], dtype=np.int64)
    cumulative = np.cumsum(weights)
    if cumulative[-1] <= 0:
        cumulative = np.arange(1.0, len(weights) + 1)
    bounds = np.rint(cumulative / cumulative[-1] * total).astype(np.int64)
    return np.asarray(np.diff(bounds, prepend=0), dtype=np.int64)


def nominal_durations(tpg: TemporalPlanGraph) -> tuple[Nanoseconds, ...]:
    """Return the planned duration of every node, per chain [ns]."""
    return tuple(to_nanoseconds(chain.duration) for chain in tpg.chains)


def total_duration_s(durations: Sequence[Nanoseconds]) -> float:
    """Return the sum of all durations [s]: the makespan of one robot at a time."""
    return sum(int(d.sum()) for d in durations) / NANOSECONDS
