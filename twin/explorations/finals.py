"""Final comparison of the best designs, and the gain of each change, with common random numbers.

Designs that were selected for their results in the search look better in its replications than they are (selection
bias). Therefore the comparison uses new replications. Designs are compared replication by replication.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from planning.errors import OutputError
from planning.transforms import Array
from twin.explorations.crew import Evaluators
from twin.explorations.dimensions import variant_of
from twin.explorations.exploration import Exploration
from twin.explorations.folder import read_sample, write_sample
from twin.explorations.influence import evenly_spread
from twin.explorations.journal import JOURNAL, REPLANNED, UNDONE, TriedDesign
from twin.explorations.rungs import (
    ExplorationSetting,
    RungClimb,
    complete_evaluation,
    keys_of,
    replicated_results,
)
from twin.explorations.section import REPLICATED
from twin.host.progress import Report
from twin.scenario.variations import Variant, apply_variation
from twin.studies.gains.paired_quantiles import PairedQuantiles
from twin.studies.replications.experiment import Block
from twin.studies.replications.statistics import (
    Interval,
    mean_interval,
    paired_interval,
)
from twin.studies.replications.workload import compute_block

RACING, UNDOING = "comparison of the best designs", "what changes are worth"
REPLANNING = "plans with other seeds"
"""Names of the stages for progress displays."""

_BLOCK_SIZE = 500
"""Replications that are executed in one block."""

_MOST_BY_EVENT_ENGINE = 200
"""Most replications of a finalist where only the event engine, which is slow, can execute it."""

_COMPROMISES = 20
"""Most compromises (Pareto-optimal designs) that are replicated further."""

_PLAN_RESULTS = REPLICATED | {"makespan_s"}
"""Results that depend on the plan."""

_PERCENTILES = {"p50_s": 0.5, "p90_s": 0.9}
"""Results that are quantiles of the makespan."""

_RESAMPLES = 2000
"""Bootstrap resamples for intervals of goals other than means."""


@dataclass(frozen=True)
class Finalist:
    """One of the best designs, replicated further.

    Attributes:
        row: its evaluation in the search.
        makespans_s: makespans of new replications, NaN for those that did not complete [s].
        goals: values of the goals over these; smaller is better.
        behind: difference of its goal from that of the best design; None for the best one, and if unknown.
        apart: whether it is significantly worse; with several goals, than some other design in all of them.
        unsure: with several goals, whether another design may dominate it or be dominated by it.
    """

    row: TriedDesign
    makespans_s: Array
    goals: tuple[float, ...]
    behind: Interval | None
    apart: bool
    unsure: bool = False


@dataclass(frozen=True)
class ChangeValue:
    """Gain of a change of the best design.

    Attributes:
        key: the changed key; empty for all changes together, against the base design.
        words: text on the change.
        gain: by how much the goal is better with it; None where there is no design without it.
        reason: why there is no design without it.
        by_plans: of all changes together, the mean gain over several plans of both designs, each pair with
            another seed of the planner; None where that is not known.
    """

    key: str
    words: str
    gain: Interval | None
    reason: str = ""
    by_plans: Interval | None = None

    def content(self) -> dict[str, Any]:
        """Return it for JSON."""
        entries = {**vars(self)}
        for name in ("gain", "by_plans"):
            entries[name] = entries[name] and entries[name].content()
        return entries


class Finals:
    """The best designs of an exploration, replicated with new draws.

    Args:
        exploration: whose search is over.
        setting: common setting of all designs.
        progress: receives the progress of each stage.
    """

    def __init__(
        self, exploration: Exploration, setting: ExplorationSetting, progress: Report
    ) -> None:
        self._exploration, self._setting = exploration, setting
        self._section, self._progress = setting.section, progress
        self._goals = setting.section.goals
        self._drawn = [bool(g.expression.used & REPLICATED) for g in self._goals]
        self._samples: dict[str, Array] = {}
        self._resamples: dict[tuple[str, int, int, int], Array] = {}

    def race(self) -> tuple[Finalist, ...]:
        """Replicate the best designs until the best is significant, or the limit is reached."""
        section = self._section
        rows = list(self._exploration.finalists())
        if not rows:
            return ()
        if len(section.goals) > 1:
            return self._race_compromises(evenly_spread(rows, _COMPROMISES))
        targets = self._targets(len(rows))
        risk = (1.0 - section.confidence) / (max(len(rows) - 1, 1) * len(targets))
        racing, out = rows, dict[int, Finalist]()
        for look, count in enumerate(targets):
            self._progress(RACING, look, len(targets))
            goals = {row.design: self._values(row, count) for row in racing}
            best = min(racing, key=lambda row: (goals[row.design], row.design))
            for row in racing:
                behind = None
                if row is not best:
                    behind = self.difference(row, best, count, 1.0 - risk)
                apart = behind is not None and behind.low > 0.0
                sample = self._sample(row, count)
                out[row.design] = Finalist(
                    row, sample, goals[row.design], behind, apart
                )
            racing = [row for row in racing if not out[row.design].apart]
            if len(racing) == 1:
                break
        self._progress(RACING, len(targets), len(targets))
        return tuple(sorted(out.values(), key=lambda f: (f.apart, f.goals)))

    def _targets(self, racing: int) -> list[int]:
        """Return numbers of replications after which designs are compared, for a number of finalists."""
        section = self._section
        targets, most = [section.replications], section.most_replications
        if any(self._setting.scenario.execution.needs_event_engine()):
            most = min(most, max(_MOST_BY_EVENT_ENGINE, section.replications))
        while any(self._drawn) and racing > 1 and targets[-1] < most:
            targets.append(min(2 * targets[-1], most))
        return targets

    def _race_compromises(self, rows: Sequence[TriedDesign]) -> tuple[Finalist, ...]:
        """Replicate compromises until dominated ones are significant."""
        unknown, beaten = list(combinations(rows, 2)), set[int]()
        targets = self._targets(len(rows))
        looks = max(len(unknown) * len(self._goals) * len(targets), 1)
        confidence = 1.0 - (1.0 - self._section.confidence) / looks
        last = dict.fromkeys((row.design for row in rows), targets[0])
        for look, count in enumerate(targets):
            self._progress(RACING, look, len(targets))
            last |= {row.design: count for row in rows if row.design not in beaten}
            left = []
            for one, other in unknown:
                if not beaten & {one.design, other.design}:
                    better = self._better(one, other, count, confidence)
                    if better is None:
                        left.append((one, other))
                    elif better:
                        beaten.add((other if better > 0 else one).design)
            unknown = [p for p in left if not beaten & {row.design for row in p}]
            if not unknown:
                break
        self._progress(RACING, len(targets), len(targets))
        unsure = {row.design for pair in unknown for row in pair}
        out = []
        for row in rows:
            place, count = row.design, last[row.design]
            sample, goals = self._sample(row, count), self._values(row, count)
            entries = place in beaten, place in unsure
            out.append(Finalist(row, sample, goals, None, *entries))
        return tuple(sorted(out, key=lambda f: (f.apart, f.goals)))

    def _better(
        self, one: TriedDesign, other: TriedDesign, count: int, confidence: float
    ) -> int | None:
        """Return 1 if a design dominates another; -1 if dominated; 0 if neither; None if not significant.

        A difference that may be zero by its interval is not significant.
        """
        signs = set[int | None]()
        for goal in range(len(self._goals)):
            found = self.difference(one, other, count, confidence, goal)
            if found is None or found.low <= 0.0 <= found.high:
                exact = found is not None and found.low == found.high
                signs.add(0 if exact else None)
            else:
                signs.add(1 if found.high < 0.0 else -1)
        if signs >= {1, -1} or signs == {0}:
            return 0
        return None if None in signs else (1 if 1 in signs else -1)

    def change_values(
        self, best: Finalist, crew: Evaluators
    ) -> tuple[ChangeValue, ...]:
        """Return the gain of all changes of a design, then of each, the greatest first.

        Each change is undone alone, planned, and replicated with the same draws.

        Args:
            best: the design.
            crew: evaluates designs.
        """
        exploration, found = self._exploration, list[ChangeValue]()
        values, dimensions = best.row.values, exploration.dimensions
        changed = [one for one in dimensions if one.change(values[one.key])]
        if not changed:
            return ()
        undone = {one.key: {**values, one.key: one.base} for one in changed}
        todo = [
            (without, key)
            for key, without in undone.items()
            if (known := exploration.known(without)) is None
            or known.evaluation.outcome == "behind"
        ]
        exploration.evaluate(crew, UNDONE, todo, UNDOING)
        count = len(best.makespans_s)
        base = next((r for r in exploration.journal.searched if r.design == 0), None)
        everything = "; ".join(one.words(values[one.key]) for one in changed)
        for key, words, other in (
            ("", everything, base),
            *(
                (
                    one.key,
                    one.words(values[one.key]),
                    exploration.known(undone[one.key]),
                )
                for one in changed
            ),
        ):
            if other is None or (key and len(changed) == 1):
                continue
            if not other.done:
                reason = f"{other.evaluation.rung}: {other.evaluation.reason}"
                found.append(ChangeValue(key, words, None, reason))
                continue
            gain = self.difference(other, best.row, count, self._section.confidence)
            by_plans = None if key else self.gain_by_plans(other, best.row, count, crew)
            found.append(ChangeValue(key, words, gain, by_plans=by_plans))
        return tuple(sorted(found, key=_greatest_first))

    def gain_by_plans(
        self, base: TriedDesign, best: TriedDesign, count: int, crew: Evaluators
    ) -> Interval | None:
        """Return the mean gain of a design over plans of both, each pair with another seed of the planner.

        Among many designs of about the same quality, a search prefers one that happened to get a good plan. The
        mean over plans is the gain that remains when the cell is planned again.

        Args:
            base, best: the scenario as it is, and the design.
            count: of replications.
            crew: plans and evaluates.

        Returns:
            Student's interval of the differences; None where the first goal depends on no plan, or only the
            first pair of plans is feasible.
        """
        exploration, own = self._exploration, self._setting.scenario.seed
        seeds = range(own + 1, own + self._section.plans)
        if not self._goals[0].expression.used & _PLAN_RESULTS:
            return None
        wanted = [
            (row.values, str(seed))
            for seed in seeds
            for row in (base, best)
            if exploration.replanned(row.values, seed) is None
        ]
        exploration.evaluate(crew, REPLANNED, wanted, REPLANNING)
        pairs = [(base, best)]
        for seed in seeds:
            one, other = (exploration.replanned(r.values, seed) for r in (base, best))
            if one is not None and other is not None and one.done and other.done:
                pairs.append((one, other))
        gains = [
            self._values(one, count)[0] - self._values(other, count)[0]
            for one, other in pairs
        ]
        known = np.array(gains)[np.isfinite(gains)]
        if len(known) < 2:
            return None
        return mean_interval(known, confidence=self._section.confidence)

    def difference(
        self,
        one: TriedDesign,
        other: TriedDesign,
        count: int,
        confidence: float,
        goal: int = 0,
    ) -> Interval | None:
        """Return the difference of a goal between two designs, over new replications.

        For a mean it is computed from the differences of all replications, for a quantile as in
        ``PairedQuantiles``, and for another expression by a bootstrap with the same resamples for both.
        """
        first, second = self._sample(one, count), self._sample(other, count)
        section = self._goals[goal]
        about = section.expression.text.strip()
        if about == "mean_s" or about in _PERCENTILES:
            both = np.isfinite(first) & np.isfinite(second)
            found = paired_interval(first, second, confidence=confidence)
            if about in _PERCENTILES and found is not None:
                own: dict[str, Any] = {"confidence": confidence}
                own |= {"seed": self._setting.scenario.seed}
                base = PairedQuantiles(first[both], _PERCENTILES[about], **own)
                found = base.reduction(second[both])
            return found if found is None or section.sign > 0 else _negated(found)
        value, against = (
            self._goal_function(one, goal),
            self._goal_function(other, goal),
        )
        estimate = value(first) - against(second)
        if not self._drawn[goal]:
            return Interval(estimate, estimate, estimate, 0)
        known = self._resampled(one, goal, count) - self._resampled(other, goal, count)
        known = known[np.isfinite(known)]
        if not len(known):
            return None
        tail = 0.5 * (1.0 - confidence)
        low, high = np.quantile(known, [tail, 1.0 - tail])
        return Interval(estimate, float(low), float(high), count)

    def _resampled(self, row: TriedDesign, goal: int, count: int) -> Array:
        """Return a goal of a design over resamples of its replications; all designs have the same resamples."""
        key = row.purpose, row.design, goal, count
        if key not in self._resamples:
            rng = np.random.default_rng(self._setting.scenario.seed)
            drawn = rng.integers(0, count, (_RESAMPLES, count))
            sample, value = self._sample(row, count), self._goal_function(row, goal)
            with np.errstate(invalid="ignore"):
                self._resamples[key] = np.array([value(sample[i]) for i in drawn])
        return self._resamples[key]

    def _values(self, row: TriedDesign, count: int) -> tuple[float, ...]:
        sample, goals = self._sample(row, count), range(len(self._goals))
        return tuple(self._goal_function(row, goal)(sample) for goal in goals)

    def _goal_function(self, row: TriedDesign, goal: int) -> Callable[[Array], float]:
        """Return the function from makespans to the value of a goal of a design, infinite where it has none."""
        scenario = apply_variation(self._setting.scenario, self._variant(row))
        free, key = self._section.changed(constraints=()), keys_of(scenario)

        def value(makespans_s: Array) -> float:
            results = dict(row.evaluation.results)
            if any(self._drawn):
                if not np.isfinite(makespans_s).any():
                    return float(np.inf)
                results |= replicated_results(scenario, free, makespans_s)
            found = complete_evaluation(key, free, results=results)
            return found.goals[goal] if found.goals else float(np.inf)

        return value

    def _variant(self, row: TriedDesign) -> Variant:
        return variant_of(self._exploration.dimensions, row.values)

    def _sample(self, row: TriedDesign, count: int) -> Array:
        """Return the first new replications of a design; earlier ones are read from its file."""
        if not any(self._drawn):
            return np.empty(0)
        place = self._exploration.samples_of(row)
        name = place.stem
        if name not in self._samples:
            self._samples[name] = read_sample(place)
        have = self._samples[name]
        if len(have) < count:
            packed_workload, first = (
                self._packed_workload(row),
                self._section.replications,
            )
            parts = [have]
            for at in range(len(have), count, _BLOCK_SIZE):
                block = Block(0, first + at, min(_BLOCK_SIZE, count - at))
                parts.append(compute_block(packed_workload, block).rows.makespans_s())
            self._samples[name] = have = np.concatenate(parts)
            write_sample(place, have)
        return have[:count]

    def _packed_workload(self, row: TriedDesign) -> bytes:
        """Return the packed workload of a design, which is planned again if it is not in memory."""
        packed_workload = self._exploration.packed_workload_of(row)
        if not packed_workload:
            seed = int(row.about) if row.purpose == REPLANNED else None
            climb = RungClimb(self._setting, self._variant(row), planner_seed=seed)
            found = climb.evaluate()
            if not found.packed_workload:
                raise OutputError(
                    f"{self._exploration.folder / JOURNAL}: design {row.design} is said to be possible,"
                    f" and is not: {found.rung}: {found.reason}"
                )
            packed_workload = found.packed_workload
            self._exploration.keep_packed_workload(row, packed_workload)
        return packed_workload


def _negated(found: Interval) -> Interval:
    return replace(found, estimate=-found.estimate, low=-found.high, high=-found.low)


def _greatest_first(item: ChangeValue) -> tuple[bool, bool, float]:
    gain = float("inf") if item.gain is None else item.gain.estimate
    return bool(item.key), item.gain is None, -gain
