"""Picks rows of the construction benchmark and sums them up."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from benchmarks.construction.paper import TEAMS
from benchmarks.store import Row


@dataclass(frozen=True)
class Spread:
    """Mean and sample standard deviation of some values, None where there are none."""

    values: tuple[float, ...]

    @property
    def mean(self) -> float:
        """Their mean; nan of none."""
        return float(np.mean(self.values)) if self.values else float("nan")

    @property
    def std(self) -> float:
        """Their sample standard deviation; 0 of fewer than two."""
        return float(np.std(self.values, ddof=1)) if len(self.values) > 1 else 0.0

    def text(self, digits: int = 1) -> str:
        """Return both as a cell of a table."""
        if not self.values:
            return "-"
        spread = f" ± {self.std:.{digits}f}" if len(self.values) > 1 else ""
        return f"{self.mean:.{digits}f}{spread}"


def methods(rows: Sequence[Row], model: str, robots: int) -> list[Row]:
    """Return the plans of the method that were found, by seed."""
    found = [r for r in _of(rows, "method", model, robots) if r["ok"]]
    return sorted(found, key=lambda r: int(r["seed"]))


def baselines(rows: Sequence[Row], model: str, robots: int) -> dict[float, list[Row]]:
    """Return the rows of the baseline by T, failures with them."""
    out: dict[float, list[Row]] = {}
    for row in _of(rows, "baseline", model, robots):
        out.setdefault(float(row["duration_s"]), []).append(row)
    return {t: sorted(out[t], key=lambda r: int(r["seed"])) for t in sorted(out)}


def best_baseline(
    rows: Sequence[Row], model: str, robots: int
) -> tuple[float, list[Row]] | None:
    """Return the T with the shortest plan for the first seed, and its plans that were found."""
    found = {
        t: [r for r in trials if r["ok"]]
        for t, trials in baselines(rows, model, robots).items()
    }
    first = {
        t: float(r["makespan_s"])
        for t, trials in found.items()
        for r in trials
        if r["seed"] == 0
    }
    if not first:
        return None
    best = min(first, key=lambda t: first[t])
    return best, found[best]


def cases(rows: Sequence[Row]) -> list[tuple[str, int]]:
    """Return the models and sizes of teams of which there is anything, in order."""
    seen = {(str(row["model"]), int(row["robots"])) for row in rows}
    order = list(TEAMS)
    return sorted(seen, key=lambda case: (order.index(case[0]), case[1]))


def models_of(rows: Sequence[Row]) -> list[str]:
    """Return the models of which there is anything, in order."""
    return list(dict.fromkeys(model for model, _ in cases(rows)))


def teams_of(rows: Sequence[Row], model: str) -> list[int]:
    """Return the sizes of teams of which there is anything for a model, in order."""
    return [robots for name, robots in cases(rows) if name == model]


class Planned(NamedTuple):
    """Plans of one model by one size of team.

    Attributes:
        model: its name.
        robots: size of the team.
        found: plans of the method that were found, by seed.
    """

    model: str
    robots: int
    found: list[Row]


def planned(rows: Sequence[Row]) -> Iterator[Planned]:
    """Yield all that the method has planned, in order."""
    for model, robots in cases(rows):
        found = methods(rows, model, robots)
        if found:
            yield Planned(model, robots, found)


class Compared(NamedTuple):
    """The method beside the baseline with the best T, on the same seeds.

    Attributes:
        model: its name.
        robots: size of the team.
        duration: T [s].
        fixed: plans of the baseline.
        own: plans of the method.
    """

    model: str
    robots: int
    duration: float
    fixed: list[Row]
    own: list[Row]


def compared(rows: Sequence[Row]) -> Iterator[Compared]:
    """Yield all that both have planned, in order."""
    for model, robots in cases(rows):
        best = best_baseline(rows, model, robots)
        if best is None:
            continue
        fixed, own = same_seeds(best[1], methods(rows, model, robots))
        if own:
            yield Compared(model, robots, best[0], fixed, own)


def spread(rows: Sequence[Row], *keys: str) -> Spread:
    """Return the spread of a value, or of what is found under one key after another."""
    values = []
    for row in rows:
        value = row
        for key in keys:
            value = value.get(key, 0.0)
        values.append(float(value))  # type: ignore[arg-type]
    return Spread(tuple(values))


def same_seeds(one: Sequence[Row], other: Sequence[Row]) -> tuple[list[Row], list[Row]]:
    """Return the rows of both with seeds that both have."""
    seeds = {r["seed"] for r in one} & {r["seed"] for r in other}
    return [r for r in one if r["seed"] in seeds], [
        r for r in other if r["seed"] in seeds
    ]


def computing(row: Row) -> float:
    """Return the processor time of planning alone: what the baseline has, too [s]."""
    spent = row["cpu_s"]
    return float(spent["total"]) - float(spent.get("checks", 0.0))


def _of(rows: Sequence[Row], what: str, model: str, robots: int) -> list[Row]:
    return [
        r
        for r in rows
        if r["what"] == what and r["model"] == model and r["robots"] == robots
    ]
