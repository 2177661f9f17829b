"""Key figures of a study for ``summary.json``: makespans under each policy and variant of the inputs, and differences.

Their confidence intervals are computed in ``twin.studies.replications.statistics``.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field

from planning.transforms import Array
from twin.audits.worlds.engines import engine_and_version, engine_named
from twin.durations.nanoseconds import NANOSECONDS
from twin.runs.policies import OPEN_LOOP, PLAIN_POLICIES, preferred_policy
from twin.scenario.variations import (
    Variant,
    apply_variation,
    is_of_execution,
    layout_of,
)
from twin.studies.folder import RefusedLayout, StudyRequest
from twin.studies.operated_figures import OperatedSummary
from twin.studies.products import (
    LineSummary,
    line_summary,
    orders_of,
)
from twin.studies.replications.block_results import (
    COMPLETED,
    ERROR,
    WAIT_COLUMNS,
    cell_blocks,
    cell_makespans_s,
    cell_part,
)
from twin.studies.replications.experiment import Experiment
from twin.studies.replications.statistics import (
    Figures,
    Interval,
    SummaryEntry,
    mean_interval,
    paired_interval,
    quantile_interval,
    share_interval,
)
from twin.studies.replications.workload import Workload
from twin.studies.sensitivity import Influence, SobolIndex
from twin.studies.window_figures import WindowsSummary, windows_summary
from twin.warnings.plan_warnings import stall_warnings
from twin.warnings.unreached_speeds import unreached_speeds

QUANTILES = (50, 90, 95, 99)
"""Reported percentiles of the makespan."""


class CellSummary(Figures):
    """Figures of one policy with one variant.

    Attributes:
        policy: name of twin.runs.policies.
        variant: values of the varied keys.
        replications: how many there are.
        outcomes: how many ended how.
        not_completed: share of those that did not complete.
        errors: replications that raised.
        makespan_s: its mean [s]; like the following ones missing where none completed.
        makespan_sd_s: its standard deviation, None where there is one replication [s].
        makespan_p50_s, makespan_p90_s, makespan_p95_s, makespan_p99_s: its percentiles [s].
        in_time: share of those that complete before the deadline, where there is one.
        utilisation: share of the time that each robot and machine is at work.
        wait_s: mean wait of all robots together, by the columns of WAIT_COLUMNS [s].
        engine: ``bulk`` or ``events``.
        event_engine_because: why only the event engine could execute it.
        collided: share of audited replications that collided, where some were audited.
        audit_engine: collision engine, with its version.
        line: line figures, for several products.
        windows: figures of time windows, where there are any.
        operated: cost of failures, with replanning.
        tornado: effects of single inputs on the mean makespan, the strongest first.
        sobol: Sobol indices of the inputs, if requested; of one cell.
        gains: the greatest gains of single and joint interventions, as in ``gains.json``.
    """

    policy: str
    variant: dict[str, Any]
    replications: int
    outcomes: dict[str, int]
    not_completed: SummaryEntry
    errors: int
    makespan_s: SummaryEntry | None = None
    makespan_sd_s: float | None = None
    makespan_p50_s: SummaryEntry | None = None
    makespan_p90_s: SummaryEntry | None = None
    makespan_p95_s: SummaryEntry | None = None
    makespan_p99_s: SummaryEntry | None = None
    in_time: SummaryEntry | None = None
    utilisation: dict[str, float] = Field(default_factory=dict)
    wait_s: dict[str, float] = Field(default_factory=dict)
    engine: str
    event_engine_because: tuple[str, ...]
    collided: SummaryEntry | None = None
    audit_engine: str = ""
    line: LineSummary | None = None
    windows: WindowsSummary | None = None
    operated: OperatedSummary | None = None
    tornado: tuple[Influence, ...] = ()
    sobol: tuple[SobolIndex, ...] = ()
    gains: tuple[dict[str, Any], ...] = ()

    @property
    def label(self) -> str:
        """Policy and varied inputs in one line."""
        return cell_label(self.policy, self.variant)

    @property
    def collisions(self) -> str:
        """Text on collisions in audited replications; empty where none was audited."""
        if self.collided is None:
            return ""
        count = self.collided.count
        off = "" if self.policy == OPEN_LOOP else ", bases and skills off as drawn,"
        return (
            f"{round(self.collided.estimate * count)} of {count} replications audited with"
            f" {self.audit_engine}{off} collided"
        )


class Difference(Figures):
    """Paired difference of two policies, replication by replication, with the same variant.

    Attributes:
        policy, reference: which.
        variant: values of the varied keys.
        makespan_s: by how much the makespan of the policy is longer [s].
        relative: the same over the mean makespan of the reference.
    """

    policy: str
    reference: str
    variant: dict[str, Any]
    makespan_s: SummaryEntry
    relative: float


class RankedLayout(Figures):
    """A layout's rank among those with the same policy and other inputs.

    Attributes:
        rank: its place, from 1.
        policy: under which.
        variant, layout: values of all varied keys, and of those its plan depends on.
        cell: index of the cell.
        mean_s: its mean makespan [s].
        behind_s: by how much it is slower than the quickest; None for that one, and where no
            replication completed with both [s].
    """

    rank: int
    policy: str
    variant: dict[str, Any]
    layout: dict[str, Any]
    cell: int
    mean_s: float
    behind_s: SummaryEntry | None

    @property
    def significantly_slower(self) -> bool:
        """Whether it is significantly slower than the fastest."""
        return self.behind_s is not None and self.behind_s.low > 0.0

    @property
    def behind(self) -> str:
        """Text on the difference to the fastest."""
        if self.rank == 1:
            return "quickest"
        if self.behind_s is None:
            return "-"
        words = f"{self.behind_s.estimate:+.2f} s"
        bounds = self.behind_s.bounds("{:+.2f}".format)
        return f"{words} ({bounds})" if bounds else words


class StudySummary(Figures):
    """All figures of a study.

    Attributes:
        scenario: name of the scenario.
        confidence: of all intervals.
        deadline_s: requested deadline, None without one [s].
        antithetic: whether replications are mirrored pairs.
        closed_loop: whether replications are replanned after failures.
        cells: of every policy with every variant.
        differences: of policies against each other.
        ranking: of the layouts under every policy, the quickest first; empty where there is only one.
        refused: layouts that cannot be planned.
        warnings: warnings about the study.
    """

    scenario: str
    confidence: float
    deadline_s: float | None
    antithetic: bool
    closed_loop: bool
    cells: tuple[CellSummary, ...]
    differences: tuple[Difference, ...]
    ranking: tuple[RankedLayout, ...]
    refused: tuple[RefusedLayout, ...]
    warnings: tuple[str, ...]

    def ranked(self, policy: str) -> list[RankedLayout]:
        """Return the layouts under a policy in their order."""
        return [row for row in self.ranking if row.policy == policy]


def summarise_study(
    request: StudyRequest,
    blocks: Path,
    loads: Sequence[Workload],
    audits: Mapping[int, Sequence[int]],
    operated: Mapping[int, OperatedSummary],
) -> StudySummary:
    """Return the figures of a study.

    Args:
        request: the request.
        blocks: folder of the block files.
        loads: the work of its cells.
        audits: collisions found in each audited replication, by cell.
        operated: cost of failures with replanning, by cell.
    """
    experiment, confidence = request.experiment, request.experiment.precision.confidence
    cells: list[CellSummary] = []
    doubts: dict[str, None] = {}
    samples = [cell_makespans_s(blocks, cell) for cell in range(len(loads))]
    for cell, (policy, variant) in enumerate(experiment.cells):
        own = apply_variation(request.scenario, variant)
        load = loads[cell]
        found = _figures(request, blocks, cell, samples[cell])
        found["engine"] = "events" if load.by_events else "bulk"
        found["event_engine_because"] = load.reasons if load.by_events else ()
        if hits := audits.get(cell):
            found |= _collided(experiment, hits)
        line = line_summary(blocks, cell, load, orders_of(own), confidence)
        if line is not None:
            found["line"] = line
        if (passed := cell_part(blocks, cell, "windows")) is not None:
            about = load.tpg, load.execution.hold, passed, samples[cell]
            found["windows"] = windows_summary(*about, confidence)
        if cell in operated:
            found["operated"] = operated[cell]
        cells.append(CellSummary(policy=policy, variant=dict(variant), **found))
        doubts |= dict.fromkeys(stall_warnings(own, load.tpg))
        if own.execution.rejecting and not request.operated:
            skills = ", ".join(own.execution.rejecting)
            words = f"replications in which {skills} fails for good count as failed: nothing is done again (--operate)"
            doubts[words] = None
        disturbances = load.execution.disturbances
        doubts |= dict.fromkeys(unreached_speeds(load.tpg, disturbances, load.seed))
    return StudySummary(
        scenario=request.scenario.name,
        confidence=confidence,
        deadline_s=request.deadline_s,
        antithetic=experiment.antithetic,
        closed_loop=request.operated,
        cells=tuple(cells),
        differences=tuple(policy_differences(experiment, samples)),
        ranking=tuple(rank_layouts(experiment, samples)),
        refused=request.refused,
        warnings=tuple(doubts),
    )


def shown_cell(summary: StudySummary, policies: Sequence[str]) -> int:
    """Return the cell that is shown first: of the policy that coordinates best, best layout."""
    policy = preferred_policy(policies)
    ranked = summary.ranked(policy)
    return ranked[0].cell if ranked else policies.index(policy)


def cell_label(policy: str, variant: Variant) -> str:
    """Return policy and varied inputs of a cell in one line."""
    return ", ".join([policy, *(f"{key} = {value}" for key, value in variant.items())])


def _figures(
    request: StudyRequest, blocks: Path, cell: int, sample: Array
) -> dict[str, Any]:
    """Return the figures of a cell's replications, by fields of CellSummary."""
    experiment = request.experiment
    confidence = experiment.precision.confidence
    busy, waited, ends = [], [], []
    outcomes: Counter[str] = Counter()
    robots: tuple[str, ...] = ()
    for result in cell_blocks(blocks, cell):
        rows = result.rows
        done = rows.outcome == COMPLETED
        busy.append(rows.busy_ns[:, done].sum(axis=1, dtype=float))
        waited.append(rows.waited_ns[:, done].sum(axis=1, dtype=float))
        ends.append(rows.makespan_ns[done].sum(dtype=float))
        robots = rows.robots
        outcomes.update(rows.outcome.tolist())
    completed = sample[np.isfinite(sample)]
    count = len(sample)

    def share(hits: int) -> Interval:
        return share_interval(hits, count, confidence=confidence)

    figures: dict[str, Any] = {
        "replications": count,
        "outcomes": dict(sorted(outcomes.items())),
        "not_completed": share(count - len(completed)),
        "errors": outcomes[ERROR],
    }
    if len(completed) == 0:
        return figures
    mirrored = experiment.antithetic and len(completed) == count > 1
    figures["makespan_s"] = mean_interval(
        completed, confidence=confidence, antithetic=mirrored
    )
    several = len(completed) > 1
    figures["makespan_sd_s"] = float(np.std(completed, ddof=1)) if several else None
    for p in QUANTILES:
        figures[f"makespan_p{p}_s"] = quantile_interval(
            completed, p / 100, confidence=confidence
        )
    if request.deadline_s is not None:
        in_time = np.count_nonzero(completed <= request.deadline_s)
        figures["in_time"] = share(int(in_time))
    total = float(np.sum(ends))
    shares = (np.sum(busy, axis=0) / total).tolist()
    figures["utilisation"] = dict(zip(robots, shares, strict=True))
    mean_waits = np.sum(waited, axis=0) / NANOSECONDS / len(completed)
    figures["wait_s"] = {
        name: float(mean_waits[cause]) for cause, name in WAIT_COLUMNS.items()
    }
    return figures


def _collided(experiment: Experiment, found: Sequence[int]) -> dict[str, Any]:
    """Return the audit's findings, by fields of CellSummary."""
    hit = sum(count > 0 for count in found)
    confidence = experiment.precision.confidence
    return {
        "collided": share_interval(hit, len(found), confidence=confidence),
        "audit_engine": engine_and_version(engine_named(experiment.audit_engine)),
    }


def policy_differences(
    experiment: Experiment, samples: Sequence[Array]
) -> Iterator[Difference]:
    """Yield policies against each other, pair by pair, within the same variant.

    Each is compared with the first one, and one with shortcuts with the best of those without, too.

    Args:
        experiment: the design of the study.
        samples: makespans of each cell, NaN where it did not complete [s].
    """
    confidence = experiment.precision.confidence
    count = len(experiment.policies)
    for k, (policy, variant) in enumerate(experiment.cells):
        begin = k - k % count
        for other in dict.fromkeys((begin, _best_plain(experiment, samples, k))):
            first, second = samples[k], samples[other]
            found = paired_interval(
                first, second, confidence=confidence, antithetic=experiment.antithetic
            )
            if other == k or found is None:
                continue
            both = np.isfinite(first) & np.isfinite(second)
            yield Difference(
                policy=policy,
                reference=experiment.policies[other - begin],
                variant=dict(variant),
                makespan_s=found,
                relative=found.estimate / float(np.mean(second[both])),
            )


def _best_plain(experiment: Experiment, samples: Sequence[Array], cell: int) -> int:
    """Return the fastest cell without shortcuts next to one with them; else the first one."""
    begin = cell - cell % len(experiment.policies)
    if experiment.cells[cell][0] in PLAIN_POLICIES:
        return begin
    means = {
        begin + k: float(np.mean(samples[begin + k]))
        for k, policy in enumerate(experiment.policies)
        if policy in PLAIN_POLICIES and np.all(np.isfinite(samples[begin + k]))
    }
    return min(means, key=lambda k: means[k], default=begin)


def rank_layouts(
    experiment: Experiment, samples: Sequence[Array]
) -> Iterator[RankedLayout]:
    """Yield the layouts of every policy, the fastest first; nothing for a single layout.

    Layouts are compared within one policy and the same other inputs. The difference of each to the
    fastest is taken replication by replication. Its interval is
    wider than that of a single comparison, so that all of them hold at once (Bonferroni).

    Args:
        experiment: the design of the study.
        samples: makespans of each cell, NaN where it did not complete [s].
    """
    if len({json.dumps(layout_of(v)) for v in experiment.variants}) < 2:
        return
    groups: dict[str, list[int]] = {}
    for cell, (policy, variant) in enumerate(experiment.cells):
        rest = {k: v for k, v in variant.items() if is_of_execution(k)}
        groups.setdefault(json.dumps([policy, rest]), []).append(cell)
    # Groups of one policy follow each other, in the order of the policies.
    order = sorted(
        groups.values(),
        key=lambda cells: experiment.policies.index(experiment.cells[cells[0]][0]),
    )
    for cells in order:
        yield from _ranked(experiment, samples, cells)


def _ranked(
    experiment: Experiment, samples: Sequence[Array], cells: Sequence[int]
) -> Iterator[RankedLayout]:
    """Yield the ranks of cells that are compared with each other."""
    confidence = experiment.precision.confidence
    done = [cell for cell in cells if np.isfinite(samples[cell]).any()]
    done.sort(key=lambda cell: float(np.nanmean(samples[cell])))
    several = 1.0 - (1.0 - confidence) / max(len(done) - 1, 1)
    for place, cell in enumerate(done):
        policy, variant = experiment.cells[cell]
        best = samples[done[0]]
        yield RankedLayout(
            rank=place + 1,
            policy=policy,
            variant=dict(variant),
            layout=dict(layout_of(variant)),
            cell=cell,
            mean_s=float(np.nanmean(samples[cell])),
            behind_s=paired_interval(
                samples[cell],
                best,
                confidence=several,
                antithetic=experiment.antithetic,
            )
            if place
            else None,
        )
