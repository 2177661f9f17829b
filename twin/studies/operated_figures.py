"""Cost of failures with replanning, and gains of preventing them."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from planning.transforms import Array
from twin.durations.nanoseconds import NANOSECONDS
from twin.operations.replicated.operating import RUNGS, SAME
from twin.studies.replications.block_results import cell_blocks, cell_makespans_s
from twin.studies.replications.experiment import Experiment
from twin.studies.replications.statistics import (
    Figures,
    SummaryEntry,
    mean_interval,
    paired_interval,
    share_interval,
)
from twin.studies.replications.workload import Workload
from twin.studies.sensitivity import scenarios_without_failures


class PreventedFailure(Figures):
    """Gain if a skill never failed, with the same draws.

    Attributes:
        skill: which.
        part: the failures that it has with a part; empty for all of the skill.
        completed: share of replications that complete then.
        completed_more: by how much that share is greater.
        sooner_s: reduction of the makespan in replications that complete in both cases, None where
            there are none [s].
    """

    skill: str
    part: str
    completed: SummaryEntry
    completed_more: float
    sooner_s: SummaryEntry | None

    @property
    def name(self) -> str:
        """Name of the failures."""
        return f"{self.skill} of {self.part}" if self.part else self.skill


class OperatedSummary(Figures):
    """Figures of a cell with replanning; makespans are of completed replications.

    Attributes:
        completed: share of replications in which all steps were done.
        gave_up: share of replications with abandoned steps.
        given_up: number of replications in which each step was abandoned, by step, if any.
        versions: mean number of new plans that took over.
        recoveries: mean number of failures for good, by kind of recovery.
        regret_s: mean excess over the plan with hindsight, None if
            unknown [s].
        regret_replanned_s: the same of replications in which new plans took over [s].
        prevented: gains of prevention, the best first.
    """

    completed: SummaryEntry
    gave_up: SummaryEntry
    given_up: dict[str, int]
    versions: SummaryEntry
    recoveries: dict[str, SummaryEntry]
    regret_s: SummaryEntry | None
    regret_replanned_s: SummaryEntry | None
    prevented: tuple[PreventedFailure, ...]


@dataclass(frozen=True)
class Prevention:
    """Workload of a cell in which some skill does not fail.

    Attributes:
        cell: index of the cell.
        skill, part: see PreventedFailure.
        load: the work; only replications in which the skill failed are operated.
    """

    cell: int
    skill: str
    part: str
    load: Workload


def find_preventions(loads: Sequence[Workload], blocks: Path) -> Iterator[Prevention]:
    """Yield possible preventions in operated cells.

    Draws have names, so a replication in which a skill does not fail is the same where it cannot.

    Args:
        loads: the work of all cells.
        blocks: folder of their results.
    """
    for cell, load in enumerate(loads):
        if load.operated is None:
            continue
        failed: dict[str, set[int]] = {}
        for rows in (result.rows for result in cell_blocks(blocks, cell)):
            assert rows.operated is not None
            for skill, own in zip(
                rows.operated.skills, rows.operated.failed, strict=True
            ):
                found = rows.replication[own > 0].tolist()
                failed.setdefault(str(skill), set()).update(found)
        for skill, part, other in scenarios_without_failures(load):
            only = frozenset(failed.get(skill, ()))
            text = f"{load.made_from} without failures of {skill} {part}"
            made_from = hashlib.sha256(text.encode()).hexdigest()
            operated = replace(load.operated, only=only)
            other = replace(other, operated=operated, made_from=made_from)
            yield Prevention(cell, skill, part, other)


def operated_summary(
    experiment: Experiment,
    blocks: Path,
    cell: int,
    prevented: Sequence[tuple[Prevention, Array]],
) -> OperatedSummary:
    """Return the figures of a cell.

    Args:
        experiment: the design of the study.
        blocks: folder of its results.
        cell: index of the cell.
        prevented: preventions in it, each with makespans; see ``prevented_makespans_s``.
    """
    confidence, mirrored = experiment.precision.confidence, experiment.antithetic
    rows = [result.rows for result in cell_blocks(blocks, cell)]
    operated = [own.operated for own in rows if own.operated is not None]
    takes = np.concatenate([own.makespans_s() for own in rows])
    knew = np.concatenate([own.knew_ns for own in operated]) / NANOSECONDS
    knew[knew < 0.0] = np.nan
    versions = np.concatenate([own.versions for own in operated])
    recoveries = np.concatenate([own.recoveries for own in operated], axis=1)
    given_up = np.concatenate([own.given_up for own in operated], axis=1)
    replanned = np.where(versions > 0, takes, np.nan)
    done, count = np.isfinite(takes), len(takes)

    def share(hits: npt.ArrayLike) -> SummaryEntry:
        return share_interval(int(np.count_nonzero(hits)), count, confidence=confidence)

    def paired(first: Array, second: Array) -> SummaryEntry | None:
        return paired_interval(
            first, second, confidence=confidence, antithetic=mirrored
        )

    found = [
        PreventedFailure(
            skill=own.skill,
            part=own.part,
            completed=share(np.isfinite(other)),
            completed_more=float(np.mean(np.isfinite(other)) - np.mean(done)),
            sooner_s=paired(takes, other),
        )
        for own, other in prevented
    ]
    found.sort(
        key=lambda one: (
            -one.completed_more,
            0.0 if one.sooner_s is None else -one.sooner_s.estimate,
        )
    )
    often = zip(operated[0].steps.tolist(), given_up.sum(axis=1).tolist(), strict=True)
    return OperatedSummary(
        completed=share(done),
        gave_up=share(given_up.any(axis=0)),
        given_up={str(step): times for step, times in often if times},
        versions=mean_interval(versions, confidence=confidence),
        recoveries={
            rung: mean_interval(own, confidence=confidence)
            for rung, own in zip(RUNGS, recoveries, strict=True)
        },
        regret_s=paired(takes, knew),
        regret_replanned_s=paired(replanned, knew),
        prevented=tuple(found),
    )


def prevented_makespans_s(
    blocks: Path, cell: int, prevented: Path, place: int
) -> Array:
    """Return the makespans of a cell with a prevention, NaN where it did not complete [s].

    Args:
        blocks, cell: folder of what came of the cell itself, and its index.
        prevented, place: the same of the prevention.
    """
    rows = [result.rows for result in cell_blocks(prevented, place)]
    same = np.concatenate([other.outcome == SAME for other in rows])
    others = np.concatenate([other.makespans_s() for other in rows])
    return np.where(same, cell_makespans_s(blocks, cell), others)
