"""Summary of a design exploration: best designs, gains, importance of design variables, and rejected designs."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from twin.explorations.dimensions import Dimension, Values
from twin.explorations.exploration import Exploration
from twin.explorations.finals import ChangeValue, Finalist
from twin.explorations.influence import Importance, importances, pareto_front
from twin.explorations.journal import SINGLE, TriedDesign
from twin.explorations.rungs import CONSTRAINT, RUNGS
from twin.explorations.section import ExploreSection
from twin.explorations.single_changes import SingleChange
from twin.studies.replications.statistics import Interval, mean_interval

_NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e-?\d+)?")


@dataclass(frozen=True)
class RungFigures:
    """Figures of designs at a rung.

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
    """A feasible design.

    Attributes:
        rank: its place, from 1.
        design: its number.
        values: value of each key.
        changes: text on differences from the scenario.
        goals: values of the goals; of finalists over new replications.
        results: its results in the search.
        mean_s: of the makespan of its replications [s], None where there are none.
        behind: of a finalist, by how much it is worse than the best; None for all others.
        apart: of a finalist, whether it is known to be worse; with several goals, in each of them than another.
        unsure: of a finalist of several goals, whether it is open which of it and another is a compromise.
        compromise: whether no other design is as good in every goal.
    """

    rank: int
    design: int
    values: Values
    changes: tuple[str, ...]
    goals: tuple[float, ...]
    results: Mapping[str, float]
    mean_s: Interval | None
    behind: Interval | None = None
    apart: bool = False
    unsure: bool = False
    compromise: bool = False

    @property
    def label(self) -> str:
        """Its changes, in a line."""
        return "; ".join(self.changes) or "the scenario as it is"

    def content(self) -> dict[str, Any]:
        """Return it for JSON."""
        content = {**vars(self), "changes": list(self.changes)}
        for name in ("mean_s", "behind"):
            content[name] = content[name] and content[name].content()
        return content


@dataclass(frozen=True)
class ExploreSummary:
    """Findings of an exploration.

    Attributes:
        scenario: name of the scenario.
        section: the request.
        rows: designs of the search, each once.
        tried: designs that were tried.
        ranked: designs that are possible, the best first.
        worths: gain of all changes of the best one, then of each; with one goal.
        importances: importance for the first goal, the greatest first.
        rungs: figures of designs at each rung.
        refusals: why designs are refused, the most frequent reason first.
        singles: single changes with the greatest gain per effort, if requested.
    """

    scenario: str
    section: ExploreSection
    rows: tuple[TriedDesign, ...]
    tried: int
    ranked: tuple[RankedDesign, ...]
    worths: tuple[ChangeValue, ...]
    importances: tuple[Importance, ...]
    rungs: tuple[RungFigures, ...]
    refusals: tuple[RefusedGroup, ...]
    singles: tuple[SingleChange, ...] = ()

    @property
    def base(self) -> RankedDesign | None:
        """The base design; None where that is refused."""
        return next((item for item in self.ranked if item.design == 0), None)

    @property
    def compromises(self) -> tuple[RankedDesign, ...]:
        """The non-dominated designs."""
        return tuple(item for item in self.ranked if item.compromise)

    @property
    def decided(self) -> bool:
        """True if the best design is significantly better than all other finalists; or the compromises are significant."""
        if len(self.section.goals) > 1:
            return bool(self.ranked) and not any(item.unsure for item in self.ranked)
        others = [item for item in self.ranked[1:] if item.behind is not None]
        return bool(self.ranked) and all(item.apart for item in others)

    def content(self) -> dict[str, Any]:
        """Return it for JSON."""
        return {
            "scenario": self.scenario,
            "goals": [goal.words for goal in self.section.goals],
            "constraints": list(self.section.constraints),
            "sampler": self.section.chosen_sampler,
            "tried": self.tried,
            "evaluated": len(self.rows),
            "decided": self.decided,
            "base": None if self.base is None else self.base.content(),
            "best": [item.content() for item in self.ranked],
            "worth": [item.content() for item in self.worths],
            "importance": [item.content() for item in self.importances],
            "rungs": [item.content() for item in self.rungs],
            "single_changes": [item.content() for item in self.singles],
            "refused": [vars(item) for item in self.refusals],
        }


def summary_of(
    scenario: str,
    exploration: Exploration,
    finalists: Sequence[Finalist],
    worths: Sequence[ChangeValue],
    seed: int,
    singles: Sequence[SingleChange] = (),
) -> ExploreSummary:
    """Return what an exploration found.

    Args:
        scenario: its name.
        exploration: whose search is over.
        finalists: the best designs, replicated further, the best first.
        worths: gains of changes of the best.
        seed: of bootstraps.
        singles: single changes that gain most.
    """
    section, dimensions = exploration.section, exploration.dimensions
    alone = [row for row in exploration.journal.rows if row.purpose == SINGLE]
    searched = [*exploration.journal.searched, *alone]
    own = tuple(row for row in searched if row.same_as is None)
    final = {item.row.design: item for item in finalists}
    known = sorted(
        (row for row in own if row.done and row.design not in final),
        key=lambda r: (r.evaluation.goals, r.design),
    )
    best = _compromises(own, finalists) if len(section.goals) > 1 else set()
    ordered = [*(item.row for item in finalists), *known]
    ranked = tuple(
        ranked_design(
            rank,
            row,
            section,
            dimensions,
            final.get(row.design),
            compromise=row.design in best,
        )
        for rank, row in enumerate(ordered, start=1)
    )
    confidence = section.confidence
    matter: tuple[Importance, ...] = ()
    if not alone:
        matter = importances(own, dimensions, confidence=confidence, seed=seed)
    return ExploreSummary(
        scenario,
        section,
        own,
        len(searched),
        ranked,
        tuple(worths),
        matter,
        tuple(_rungs(own)),
        tuple(_refusals(own)),
        tuple(singles),
    )


def _compromises(
    rows: Sequence[TriedDesign], finalists: Sequence[Finalist]
) -> set[int]:
    """Return the numbers of the compromises: of finalists by their new replications, of others by the search."""
    new = [
        replace(f.row, evaluation=replace(f.row.evaluation, goals=f.goals))
        for f in finalists
        if not f.apart
    ]
    others = {row.design for row in pareto_front(rows)} - {
        f.row.design for f in finalists
    }
    return {row.design for row in pareto_front(new)} | others


def ranked_design(
    rank: int,
    row: TriedDesign,
    section: ExploreSection,
    dimensions: Sequence[Dimension],
    final: Finalist | None,
    *,
    compromise: bool,
) -> RankedDesign:
    """Return a feasible design with its rank."""
    found = row.evaluation
    goals = found.goals if final is None else final.goals
    sample = np.array(found.makespans_s)
    if final is not None and len(final.makespans_s):
        sample = final.makespans_s
    known = sample[np.isfinite(sample)]
    return RankedDesign(
        rank,
        row.design,
        row.values,
        changes_of(row.values, dimensions),
        tuple(g.sign * v for g, v in zip(section.goals, goals, strict=True)),
        found.results,
        mean_interval(known, confidence=section.confidence) if len(known) else None,
        None if final is None else final.behind,
        final is not None and final.apart,
        final is not None and final.unsure,
        compromise,
    )


def changes_of(values: Values, dimensions: Sequence[Dimension]) -> tuple[str, ...]:
    """Return texts on a design's differences from the scenario."""
    return tuple(
        one.words(values[one.key]) for one in dimensions if one.change(values[one.key])
    )


def _rungs(rows: Sequence[TriedDesign]) -> list[RungFigures]:
    found = []
    for rung in (*RUNGS, CONSTRAINT):
        there = [row.evaluation for row in rows if row.evaluation.rung == rung]
        spent = [r.evaluation.cpu_s[rung] for r in rows if rung in r.evaluation.cpu_s]
        found.append(
            RungFigures(
                rung,
                max(len(spent), len(there)),
                sum(e.outcome == "refused" for e in there),
                sum(e.outcome == "behind" for e in there),
                float(np.mean(spent)) if spent else 0.0,
            )
        )
    return [item for item in found if item.came or item.rung != CONSTRAINT]


def _refusals(rows: Sequence[TriedDesign]) -> list[RefusedGroup]:
    """Return reasons, those that differ in numbers alone as one, the most frequent first."""
    groups: dict[tuple[str, str], list[TriedDesign]] = {}
    for row in rows:
        found = row.evaluation
        if found.outcome == "refused":
            words = _NUMBER.sub("#", found.reason)
            groups.setdefault((found.rung, words), []).append(row)
    reasons = [
        RefusedGroup(rung, items[0].evaluation.reason, len(items), items[0].design)
        for (rung, _), items in groups.items()
    ]
    return sorted(reasons, key=lambda item: (-item.count, item.design))
