"""Gains: estimated reduction of makespans by interventions, each of which shortens a part of a plan.

The replications of a study are simulated again with the same random draws, and with one part of the plan shortened.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from planning.transforms import Array, Indices
from twin.durations.nanoseconds import NANOSECONDS
from twin.host.progress import Report, report_nothing
from twin.studies.gains.candidates import CandidateLimits, candidates
from twin.studies.gains.paired_quantiles import PairedQuantiles
from twin.studies.gains.replays import (
    Intervention,
    Replay,
    needs_event_engine,
    replay_cost,
)
from twin.studies.replications.experiment import Experiment
from twin.studies.replications.statistics import Figures, SummaryEntry, mean_interval
from twin.studies.replications.workload import Workload

SHORTER, GONE = 0.2, 1.0
"""Shares by which the time of an intervention is reduced."""

QUANTILE = 0.9
"""Quantile of the makespan whose gain is reported besides that of the mean."""

LEADING = 7
"""Most gains of either kind on the first page of the report and in the summary."""

TRYING = "what is worth fixing"
"""Name of the stage for progress displays."""

_MANY = CandidateLimits(tasks=20, skills=7, waits=12, robots=8)
_FEW = CandidateLimits(tasks=6, skills=7, waits=0, robots=2)
"""Limits with longest paths, and with the event engine, which takes a thousand times as long."""

_BUDGET = 500_000_000
"""Nodes and edges processed for a study: some seconds, whatever its size."""

_BUDGET_BY_EVENTS = 1_000_000
"""The same with the event engine."""

_LEAST_RUNS, _MOST_RUNS = 100, 2000
_FEWEST = 20
"""Bounds of the number of replications of a cell; ``_FEWEST`` for plans so long that more would take minutes."""

_LEAST_BY_EVENTS, _MOST_BY_EVENTS = 8, 200
"""The same bounds with the event engine; no intervention is tried where fewer are affordable."""

_MOST_VALUES = 8_000_000
"""Nodes and edges times replications that are in memory at once."""

INTERVENTION_FIELDS = ("kind", "many", "name", "robot", "task")
"""Fields of an intervention in both files."""


class Saving(Figures):
    """Reduction of the makespan.

    Attributes:
        mean_s: reduction of its mean [s].
        p90_s: reduction of its 90th percentile [s].
    """

    mean_s: SummaryEntry
    p90_s: SummaryEntry


@dataclass(frozen=True)
class Gain:
    """Reduction of the makespan by one intervention.

    Attributes:
        intervention: the intervention.
        shorter: reduction when its time is a fifth shorter.
        gone: reduction when its time is zero.
    """

    intervention: Intervention
    shorter: Saving
    gone: Saving


@dataclass(frozen=True)
class CellGains:
    """Gains in one cell of a study.

    Attributes:
        replications: number of replications executed again, the first ones that complete; 0 where the
            plan is too large for that, or none completes.
        engine: ``paths`` or ``events``.
        gains: the greatest first.
    """

    replications: int
    engine: str
    gains: tuple[Gain, ...]

    def best(self, most: int, *, many: bool) -> tuple[Gain, ...]:
        """Return the greatest gains of joint or of single interventions."""
        return tuple(g for g in self.gains if g.intervention.many == many)[:most]

    @property
    def leading(self) -> tuple[dict[str, Any], ...]:
        """The greatest gains for JSON: of single interventions, then of joint ones."""
        found = (self.best(LEADING, many=many) for many in (False, True))
        return tuple(gain_content(gain) for gains in found for gain in gains)


def study_gains(
    experiment: Experiment,
    loads: Sequence[Workload],
    counts: Sequence[int],
    progress: Report = report_nothing,
) -> list[CellGains]:
    """Return the gains in every cell of a study, given the number of replications of each."""
    found = []
    for k, (load, count) in enumerate(zip(loads, counts, strict=True)):
        progress(TRYING, k, len(loads))
        found.append(cell_gains(experiment, load, count, share=1.0 / len(loads)))
    progress(TRYING, len(loads), len(loads))
    return found


def cell_gains(
    experiment: Experiment, load: Workload, count: int, *, share: float = 1.0
) -> CellGains:
    """Return the gains in one cell, the greatest first.

    The same draws are executed again with the time of one intervention reduced. The numbers of replications
    and candidates follow from the size of the plan alone, never from computing time.
    """
    numbers = np.arange(_affordable(load, count, share), dtype=np.int64)
    engine = "events" if needs_event_engine(load) else "paths"
    if len(numbers) == 0:
        return CellGains(0, engine, ())
    replay = Replay(load, numbers)
    if len(replay.numbers) == 0:
        return CellGains(0, engine, ())
    most = _FEW if engine == "events" else _MANY
    found = replay.base()
    if load.bulk_until_ns and found.makespan_ns.max() >= load.bulk_until_ns:
        stopped = replace(load, bulk_until_ns=0)
        return cell_gains(experiment, stopped, count, share=share)
    interventions = candidates(replay, found, load.execution, most)
    base = _seconds(found.makespan_ns)
    del found  # as large as all draws, several times
    gains = list(_gains(experiment, load, replay, base, interventions))
    gains.sort(key=lambda gain: -gain.shorter.mean_s.estimate)
    helpful = tuple(gain for gain in gains if gain.gone.mean_s.estimate > 0)
    return CellGains(len(replay.numbers), engine, helpful)


def _gains(
    experiment: Experiment,
    load: Workload,
    replay: Replay,
    base: Array,
    interventions: Sequence[Intervention],
) -> Iterator[Gain]:
    confidence = experiment.precision.confidence
    # Mirrored pairs are complete only where no replication is left out.
    numbers = replay.numbers
    mirrored = (
        experiment.antithetic and len(numbers) == int(numbers[-1]) + 1 and len(base) > 1
    )
    p90 = PairedQuantiles(
        base, QUANTILE, confidence=confidence, seed=load.seed, antithetic=mirrored
    )
    for intervention in interventions:
        savings = []
        for less in (SHORTER, GONE):
            changed = _seconds(replay.makespans_ns(intervention, less))
            mean = mean_interval(
                base - changed, confidence=confidence, antithetic=mirrored
            )
            savings.append(Saving(mean_s=mean, p90_s=p90.reduction(changed)))
        yield Gain(intervention, *savings)


def _affordable(load: Workload, count: int, share: float) -> int:
    """Return the number of replications of a cell to execute again."""
    interventions, least, most, budget = (
        _MANY.most_interventions,
        _LEAST_RUNS,
        _MOST_RUNS,
        _BUDGET,
    )
    if needs_event_engine(load):
        interventions, budget = _FEW.most_interventions, _BUDGET_BY_EVENTS
        least, most = _LEAST_BY_EVENTS, _MOST_BY_EVENTS
    affordable = share * budget / (2 * interventions * replay_cost(load))
    # A replication of a study takes a few times as long as executing it again by longest paths.
    affordable = max(
        affordable,
        count / (4 * interventions if needs_event_engine(load) else interventions),
    )
    if needs_event_engine(load) and affordable < least:
        return 0
    if not needs_event_engine(load):
        least = max(_FEWEST, min(least, _MOST_VALUES // 4 // replay_cost(load)))
    most = max(least, min(most, _MOST_VALUES // replay_cost(load)))
    return min(count, int(np.clip(affordable, least, most)) // 2 * 2)


def _seconds(nanoseconds: Indices) -> Array:
    return np.asarray(nanoseconds / NANOSECONDS)


def gain_content(gain: Gain) -> dict[str, Any]:
    """Return a gain for JSON."""
    intervention = {key: getattr(gain.intervention, key) for key in INTERVENTION_FIELDS}
    return {
        **intervention,
        "shorter": gain.shorter.content(),
        "gone": gain.gone.content(),
    }
