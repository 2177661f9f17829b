"""Sensitivity of the makespan to inputs of a plan: effects of single inputs (tornado chart), and Sobol indices."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from scipy.stats import qmc

from planning.parallel import map_in_parallel
from planning.transforms import Array
from scheduling.graph.temporal_plan_graph import NodeChain, TemporalPlanGraph
from twin.host.progress import Report, report_nothing
from twin.studies.gains.replays import replay_cost
from twin.studies.replications.experiment import Block
from twin.studies.replications.statistics import (
    Figures,
    Interval,
    SummaryEntry,
    paired_interval,
)
from twin.studies.replications.workload import Engines, Workload
from twin.uncertainty.chain_draws import RobotTaskNodes

SHARE = 0.2
"""Share by which inputs are made smaller and larger."""

_TORNADO, _TORNADO_BY_EVENTS = 200, 30
"""Number of replications for each input and direction, with the draws of the study's first replications."""

_FEWEST_REPLICATIONS, _MOST_PROCESSED = 20, 4_000_000
"""Least number of replications, and the number of nodes and edges of all replications that is otherwise kept."""

_RESAMPLES = 1000
"""Resamples of the bootstrap of Sobol indices."""

_SOBOL = 50
"""Number of replications of each combination of inputs, with the same draws for all."""

INFLUENCES = "effects of inputs"
SENSITIVITY = "Sobol indices"
"""Names of the stages for progress displays."""

Scaled = Callable[[Workload, float], Workload]
"""Returns the workload with an input multiplied by a factor."""


class Influence(Figures):
    """Effect of an input on the mean makespan.

    Attributes:
        name: name of the input.
        less_s: change of the mean makespan when the input is smaller, with the same draws [s].
        more_s: the same when it is larger [s].
    """

    name: str
    less_s: SummaryEntry
    more_s: SummaryEntry

    @property
    def span_s(self) -> float:
        """Length of the bar in the chart [s]."""
        return abs(self.more_s.estimate - self.less_s.estimate)


class SobolIndex(Figures):
    """The share of an input in the variance of the mean makespan.

    Attributes:
        name: name of the input.
        first: first-order index: share explained by the input alone.
        total: total index: share explained alone and with others.
    """

    name: str
    first: SummaryEntry
    total: SummaryEntry


def study_inputs(load: Workload) -> Mapping[str, Scaled]:
    """Return the uncertain inputs of a plan, by name.

    They are the durations of skills, tool actuations and each robot's other motions, and the rate of
    stalls.
    """
    kinds = {load.tpg.tasks[int(m)].kind for c in load.tpg.chains for m in set(c.task)}
    found: dict[str, Scaled] = {
        f"duration of {skill}": partial(_with_skill, skill=skill)
        for skill in load.execution.durations.models
        if skill in kinds
    }
    durations = load.execution.durations
    actuations = {key[0] for key in durations.actuations}
    actuations &= set(durations.bind(load.tpg).skills)
    found |= {
        f"time to {actuation}": partial(_with_actuation, actuation=actuation)
        for actuation in sorted(actuations)
    }
    machines = load.tpg.machine_chains()
    for k, chain in enumerate(load.tpg.chains):
        if k in machines:
            continue
        found[f"motions of {chain.robot}"] = partial(_with_motions, robot=chain.robot)
    if load.execution.disturbances.stalls.rate_per_h > 0:
        found["rate of stalls"] = _with_stalls
    return found


def input_influences(
    load: Workload, *, confidence: float = 0.95, antithetic: bool = False
) -> list[Influence]:
    """Return the effects of the inputs on the mean makespan, the strongest first.

    One input at a time is made smaller and larger by SHARE.

    Args:
        load: the workload of one cell.
        confidence: confidence level of the intervals.
        antithetic: whether replications are mirrored pairs, see ``mean_interval``.
    """
    affordable = max(_FEWEST_REPLICATIONS, _MOST_PROCESSED // max(replay_cost(load), 1))
    most = _TORNADO_BY_EVENTS if load.reasons else _TORNADO
    block = Block(0, 0, min(most, affordable))
    base = makespans_s(load, block)

    def change(trial: tuple[Scaled, float]) -> Interval:
        scaled, factor = trial
        found = paired_interval(
            makespans_s(scaled(load, factor), block),
            base,
            confidence=confidence,
            antithetic=antithetic,
        )
        return Interval(0.0, -np.inf, np.inf, 0) if found is None else found

    inputs = study_inputs(load)
    trials = [(s, 1.0 + sign * SHARE) for s in inputs.values() for sign in (-1, 1)]
    # Only compiled code releases the interpreter lock.
    changes = (
        list(map(change, trials)) if load.reasons else map_in_parallel(change, trials)
    )
    found = [
        Influence(name=name, less_s=less, more_s=more)
        for name, less, more in zip(inputs, changes[::2], changes[1::2], strict=True)
    ]
    return sorted(found, key=lambda one: -one.span_s)


def sobol_indices(
    load: Workload,
    points: int,
    *,
    seed: int = 0,
    confidence: float = 0.95,
    progress: Report = report_nothing,
) -> list[SobolIndex]:
    """Return the Sobol indices of all inputs, the greatest total first.

    Every input is multiplied by a factor between 1 - SHARE and 1 + SHARE, evenly spread (Saltelli
    et al. 2010). Intervals are percentile bootstraps over the points of the sample: approximate.

    Args:
        load: the workload of one cell.
        points: number of points of the quasi-random sample, a power of 2; the plan is replicated with
            points x (inputs + 2) combinations.
        seed: seed of the scrambling of the sample, and of the bootstrap.
        confidence: confidence level of the intervals.
        progress: receives the numbers of combinations: done, and in all.
    """
    inputs = study_inputs(load)
    block, count = Block(0, 0, _SOBOL), len(inputs)
    if not inputs:
        return []
    done = 0

    def mean_makespans(factors: Array) -> Array:
        nonlocal done
        found = np.empty(points)
        for row, point in enumerate(factors.tolist()):
            changed = load
            for scaled, factor in zip(inputs.values(), point, strict=True):
                changed = scaled(changed, factor)
            found[row] = np.nanmean(makespans_s(changed, block))
            done += 1
            progress(SENSITIVITY, done, points * (count + 2))
        return found

    sampler = qmc.Sobol(2 * count, rng=seed, bits=64)
    spread = 1.0 - SHARE + 2.0 * SHARE * sampler.random(points)
    first, second = spread[:, :count], spread[:, count:]
    a, b = mean_makespans(first), mean_makespans(second)
    own = np.eye(count, dtype=bool)
    mixed = np.stack([mean_makespans(np.where(k, second, first)) for k in own])
    centre = 0.5 * (a.mean() + b.mean())
    a, b, mixed = a - centre, b - centre, mixed - centre
    estimates = estimate_saltelli_indices(a, b, mixed)
    drawn = np.random.default_rng(seed).integers(points, size=(_RESAMPLES, points))
    resampled = [estimate_saltelli_indices(a[i], b[i], mixed[:, i]) for i in drawn]
    tails = 0.5 * (1.0 - confidence), 0.5 * (1.0 + confidence)
    low, high = np.quantile(resampled, tails, axis=0)
    low, high = np.minimum(low, estimates), np.maximum(high, estimates)
    bounds = np.stack([estimates, low, high], axis=-1).tolist()
    firsts, totals = (
        [Interval(value, least, most, points) for value, least, most in row]
        for row in bounds
    )
    found = [
        SobolIndex(name=name, first=first_order, total=total)
        for name, first_order, total in zip(inputs, firsts, totals, strict=True)
    ]
    return sorted(found, key=lambda one: -one.total.estimate)


def estimate_saltelli_indices(a: Array, b: Array, mixed: Array) -> Array:
    """Return first-order and total Sobol indices, shape (2, d) (Saltelli et al. 2010, table 2).

    Args:
        a, b: results of two independent samples of inputs, less their mean, shape (n,).
        mixed: results of the first one with one input of the second, shape (d, n).

    Returns:
        Indices; 0 where results do not vary.
    """
    variance = float(np.var([a, b]))
    if variance == 0.0:
        return np.zeros((2, len(mixed)))
    first = np.mean(b * (mixed - a), axis=-1)
    total = 0.5 * np.mean((a - mixed) ** 2, axis=-1)
    return np.stack([first, total]) / variance


def makespans_s(load: Workload, block: Block) -> Array:
    """Return the makespans of some replications, NaN where one did not complete as planned [s]."""
    return Engines(replace(load, operated=None)).compute(block).rows.makespans_s()


def scenarios_without_failures(load: Workload) -> Iterator[tuple[str, str, Workload]]:
    """Yield skills that may fail (for one part or all), with the workload in which they do not."""
    kinds = {load.tpg.tasks[int(m)].kind for c in load.tpg.chains for m in set(c.task)}
    for skill, item in load.execution.disturbances.failures.items():
        if skill not in kinds:
            continue
        for part in ("", *item.parts):
            if part or item.probability or item.parts:
                yield skill, part, _without_failures(load, skill, part)


def _executed(load: Workload, **changes: Any) -> Workload:
    """Return the workload with changed fields of its execution model."""
    return replace(load, execution=replace(load.execution, **changes))


def _without_failures(load: Workload, skill: str, part: str) -> Workload:
    own = load.execution.disturbances
    item = own.failures[skill]
    parts = {name: p for name, p in item.parts.items() if part and name != part}
    less = item.changed(probability=item.probability if part else 0.0, parts=parts)
    failures = {**own.failures, skill: less}
    return _executed(load, disturbances=own.changed(failures=failures))


def _with_skill(load: Workload, factor: float, *, skill: str) -> Workload:
    own = load.execution.durations
    models = {
        name: model.scaled(factor) if name == skill else model
        for name, model in own.models.items()
    }
    overrides = tuple(
        item.changed(duration=item.duration.scaled(factor))
        if item.skill == skill
        else item
        for item in own.overrides
    )
    durations = replace(own, models=models, overrides=overrides)
    return _executed(load, durations=durations)


def _with_actuation(load: Workload, factor: float, *, actuation: str) -> Workload:
    own = load.execution.durations
    actuations = {
        key: model.scaled(factor) if key[0] == actuation else model
        for key, model in own.actuations.items()
    }
    return _executed(load, durations=replace(own, actuations=actuations))


def _with_motions(load: Workload, factor: float, *, robot: str) -> Workload:
    chains = tuple(
        _with_longer_motions(load.tpg, chain, factor) if chain.robot == robot else chain
        for chain in load.tpg.chains
    )
    return replace(load, tpg=replace(load.tpg, chains=chains))


def _with_longer_motions(
    tpg: TemporalPlanGraph, chain: NodeChain, factor: float
) -> NodeChain:
    """Return a chain with motion times multiplied by a factor; with acceleration limits, those at full speed."""
    factors = np.where(RobotTaskNodes(tpg, chain, {}).moves, factor, 1.0)
    drive = chain.drive
    if drive is not None:
        drive = replace(drive, cruise=factors * drive.cruise)
    return replace(chain, duration=factors * chain.duration, drive=drive)


def _with_stalls(load: Workload, factor: float) -> Workload:
    own = load.execution.disturbances
    stalls = own.stalls.changed(rate_per_h=own.stalls.rate_per_h * factor)
    return _executed(load, disturbances=own.changed(stalls=stalls))
