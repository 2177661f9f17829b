"""Importance of each design variable for a goal, and the Pareto front of designs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.stats import rankdata

from planning.transforms import Array
from twin.explorations.dimensions import Dimension, key_of
from twin.explorations.journal import TriedDesign
from twin.studies.replications.statistics import Interval

_BINS = 4
"""Ranges into which numbers are divided, with as many designs in each."""

_FEWEST = 16
"""Least number of designs for importances."""

_RESAMPLES = 300


@dataclass(frozen=True)
class Importance:
    """Share of a key in the differences between designs.

    Attributes:
        key: the varied key.
        share: of the variance of the ranks of designs by the goal, within 0 and 1, with its interval.
    """

    key: str
    share: Interval

    def content(self) -> dict[str, Any]:
        """Return it for JSON."""
        return {"key": self.key, "share": self.share.content()}


def importances(
    rows: Sequence[TriedDesign],
    dimensions: Sequence[Dimension],
    *,
    confidence: float = 0.95,
    seed: int = 0,
) -> tuple[Importance, ...]:
    """Return the importances for the first goal, the greatest first; empty for too few designs.

    Designs are ranked by it. The share of a key is what of the variance of the ranks lies between groups of
    designs: those with the same value, or within the same quarter of the numbers that were tried (epsilon
    squared, which is 0 on average where a key does not matter). Its interval is a bootstrap over designs.

    Args:
        rows: designs, each once; those with a goal count, also where it is an estimate.
        dimensions: the varied keys.
        confidence: of the intervals.
        seed: of the bootstrap.
    """
    known = [row for row in rows if row.evaluation.goals]
    if len(known) < _FEWEST:
        return ()
    values = np.array([row.evaluation.goals[0] for row in known])
    rng = np.random.default_rng(seed)
    drawn = rng.integers(0, len(known), (_RESAMPLES, len(known)))
    found = []
    for one in dimensions:
        groups = _groups(one, known)
        if len(np.unique(groups)) < 2:
            continue
        estimate = _share(values, groups)
        shares = [_share(values[i], groups[i]) for i in drawn]
        tail = 0.5 * (1.0 - confidence)
        low, high = np.quantile(shares, [tail, 1.0 - tail]).tolist()
        own = Interval(estimate, min(low, estimate), max(high, estimate), len(known))
        found.append(Importance(one.key, own))
    return tuple(sorted(found, key=lambda item: -item.share.estimate))


def _groups(one: Dimension, rows: Sequence[TriedDesign]) -> npt.NDArray[np.int64]:
    """Return the group of each design: by value, by quarter of a number, by the first entry of an order."""
    values = [row.values[one.key] for row in rows]
    if one.low is None:
        names = [key_of({"": v[0] if one.ordered else v}) for v in values]
        return np.unique(names, return_inverse=True)[1].astype(np.int64)
    numbers = np.array(values, dtype=float)
    if one.whole and len(np.unique(numbers)) <= _BINS:
        return np.unique(numbers, return_inverse=True)[1].astype(np.int64)
    borders = np.quantile(numbers, np.arange(1, _BINS) / _BINS)
    return np.searchsorted(borders, numbers).astype(np.int64)


def _share(values: Array, groups: npt.NDArray[np.int64]) -> float:
    """Return epsilon squared of the ranks of values by groups, at least 0."""
    ranks = rankdata(values)
    whole = float(np.sum((ranks - ranks.mean()) ** 2))
    kinds, place = np.unique(groups, return_inverse=True)
    if len(kinds) >= len(ranks) or whole == 0.0:
        return 0.0
    count = np.bincount(place)
    means = np.bincount(place, ranks) / count
    between = float(np.sum(count * (means - ranks.mean()) ** 2))
    within = (whole - between) / (len(ranks) - len(kinds))
    return float(np.clip((between - (len(kinds) - 1) * within) / whole, 0.0, 1.0))


def pareto_front(rows: Sequence[TriedDesign]) -> tuple[TriedDesign, ...]:
    """Return the non-dominated designs, sorted by the first goal.

    Args:
        rows: designs, each once; those that are not done do not count.
    """
    done = sorted(
        (row for row in rows if row.done), key=lambda r: (r.evaluation.goals, r.design)
    )
    found: list[TriedDesign] = []
    for row in done:
        own = np.array(row.evaluation.goals)
        if not any(np.all(np.array(o.evaluation.goals) <= own) for o in found):
            found.append(row)
    return tuple(found)


def evenly_spread(rows: Sequence[TriedDesign], most: int) -> tuple[TriedDesign, ...]:
    """Return some of many designs, from the first to the last."""
    places = np.linspace(0, len(rows) - 1, min(most, len(rows)))
    return tuple(rows[int(place)] for place in np.round(places))
