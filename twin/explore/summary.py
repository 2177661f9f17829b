"""What an exploration found: the best designs, and where and why others are refused."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from twin.explore.dimensions import Dimension, Values
from twin.explore.journal import SEARCH, Tried
from twin.explore.rungs import CONSTRAINT, RUNGS
from twin.scenario.sections.exploration import ExploreSection
from twin.study.replications.statistics import Interval, mean_interval

_NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e-?\d+)?")


@dataclass(frozen=True)
class RungFigures:
    """What came of designs at a rung.

    Attributes:
        rung: its name.
        came: designs that came to it.
        refused: how many of them did not pass it.
        behind: how many were left there, as they could not be the best.
        cpu_s: processor time it took each, on average [s].
    """

    rung: str
    came: int
    refused: int
    behind: int
    cpu_s: float

    def content(self) -> dict[str, Any]:
        """Return it for JSON."""
        return {**vars(self), "cpu_s": round(self.cpu_s, 4)}


@dataclass(frozen=True)
class RefusedGroup:
    """A reason for which designs are refused.

    Attributes:
        rung: where.
        reason: why, of the first of them.
        count: how many designs.
        design: number of the first.
    """

    rung: str
    reason: str
    count: int
    design: int


@dataclass(frozen=True)
class RankedDesign:
    """A design that is possible.

    Attributes:
        rank: its place, from 1.
        design: its number.
        values: what it has at each key.
        changes: how it differs from the scenario, in words.
        goals: values of the goals, as they are asked for.
        results: what is known of it.
        mean_s: of the makespan of its replications [s], None where there are none.
    """

    rank: int
    design: int
    values: Values
    changes: tuple[str, ...]
    goals: tuple[float, ...]
    results: Mapping[str, float]
    mean_s: Interval | None

    def content(self) -> dict[str, Any]:
        """Return it for JSON."""
        mean_s = None if self.mean_s is None else self.mean_s.content()
        return {**vars(self), "changes": list(self.changes), "mean_s": mean_s}


@dataclass(frozen=True)
class ExploreSummary:
    """What an exploration found.

    Attributes:
        scenario: name of what was explored.
        section: what was asked.
        tried: designs that were tried.
        evaluated: those that were not a design tried before.
        ranked: designs that are possible, the best first.
        base: the scenario as it is; None where that is refused.
        rungs: what came of designs at each rung.
        refusals: why designs are refused, the most frequent reason first.
    """

    scenario: str
    section: ExploreSection
    tried: int
    evaluated: int
    ranked: tuple[RankedDesign, ...]
    base: RankedDesign | None
    rungs: tuple[RungFigures, ...]
    refusals: tuple[RefusedGroup, ...]

    def content(self) -> dict[str, Any]:
        """Return it for JSON."""
        return {
            "scenario": self.scenario,
            "goals": [goal.words for goal in self.section.goals],
            "sampler": self.section.chosen_sampler,
            "tried": self.tried,
            "evaluated": self.evaluated,
            "base": None if self.base is None else self.base.content(),
            "best": [item.content() for item in self.ranked],
            "rungs": [item.content() for item in self.rungs],
            "refused": [vars(item) for item in self.refusals],
        }


def summary_of(
    scenario: str,
    section: ExploreSection,
    dimensions: Sequence[Dimension],
    rows: Sequence[Tried],
) -> ExploreSummary:
    """Return what an exploration found.

    Args:
        scenario: its name.
        section: what was asked.
        dimensions: what varied.
        rows: what became of each design.
    """
    searched = [row for row in rows if row.purpose == SEARCH]
    own = [row for row in searched if row.same_as is None]
    done = sorted(
        (row for row in own if row.done), key=lambda r: (r.evaluation.goals, r.design)
    )
    ranked = tuple(
        ranked_design(rank, row, section, dimensions)
        for rank, row in enumerate(done, start=1)
    )
    base = next((item for item in ranked if item.design == 0), None)
    return ExploreSummary(
        scenario,
        section,
        len(searched),
        len(own),
        ranked,
        base,
        tuple(_rungs(own)),
        tuple(_refusals(own)),
    )


def ranked_design(
    rank: int, row: Tried, section: ExploreSection, dimensions: Sequence[Dimension]
) -> RankedDesign:
    """Return a design that is possible, in its place."""
    found = row.evaluation
    sample = np.array(found.makespans_s)
    known = sample[np.isfinite(sample)]
    confidence = section.confidence
    changes = tuple(
        one.words(row.values[one.key])
        for one in dimensions
        if one.change(row.values[one.key])
    )
    goals = zip(section.goals, found.goals, strict=True)
    return RankedDesign(
        rank,
        row.design,
        row.values,
        changes,
        tuple(goal.sign * value for goal, value in goals),
        found.results,
        mean_interval(known, confidence=confidence) if len(known) else None,
    )


def _rungs(rows: Sequence[Tried]) -> list[RungFigures]:
    found = []
    for rung in (*RUNGS, CONSTRAINT):
        there = [row.evaluation for row in rows if row.evaluation.rung == rung]
        came = [r.evaluation.cpu_s[rung] for r in rows if rung in r.evaluation.cpu_s]
        count = len(came) if rung != CONSTRAINT else len(there)
        found.append(
            RungFigures(
                rung,
                max(count, len(there)),
                sum(e.outcome == "refused" for e in there),
                sum(e.outcome == "behind" for e in there),
                float(np.mean(came)) if came else 0.0,
            )
        )
    return [item for item in found if item.came or item.rung != CONSTRAINT]


def _refusals(rows: Sequence[Tried]) -> list[RefusedGroup]:
    """Return reasons, those that differ in numbers alone as one, the most frequent first."""
    groups: dict[tuple[str, str], list[Tried]] = {}
    for row in rows:
        found = row.evaluation
        if found.outcome == "refused":
            words = _NUMBER.sub("#", found.reason)
            groups.setdefault((found.rung, words), []).append(row)
    found_ = [
        RefusedGroup(rung, items[0].evaluation.reason, len(items), items[0].design)
        for (rung, _), items in groups.items()
    ]
    return sorted(found_, key=lambda item: (-item.count, item.design))
