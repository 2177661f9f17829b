"""Figures of a study: ``summary.json``."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from planning.transforms import Array
from twin.audit.worlds.engine import engine_and_version, engine_named
from twin.durations import NANOSECONDS
from twin.study.replications.block_results import (
    COMPLETED,
    ERROR,
    WAIT_COLUMNS,
    cell_blocks,
)
from twin.study.replications.experiment import Experiment
from twin.study.replications.statistics import (
    mean_interval,
    quantile_interval,
    share_interval,
)

QUANTILES = (0.5, 0.9, 0.95, 0.99)


def summarise_study(
    experiment: Experiment,
    blocks: Path,
    *,
    scenario: str,
    deadline_s: float | None,
    engines: Sequence[Sequence[str]],
    audits: Mapping[int, Sequence[int]],
) -> dict[str, Any]:
    """Return the figures of a study, with the keys of its ``summary.json``.

    Args:
        experiment: what was run.
        blocks: folder of the block files.
        scenario: its name.
        deadline_s: ask how likely the run is over by then [s].
        engines: why only the event engine could run a cell, by cell; empty where both could.
        audits: collisions found in each audited replication, by cell.
    """
    confidence = experiment.precision.confidence
    cells: list[dict[str, Any]] = []
    samples: list[Array] = []
    for cell, (policy, variant) in enumerate(experiment.cells):
        sample, figures = _cell(experiment, blocks, cell, deadline_s)
        samples.append(sample)
        reasons = list(engines[cell])
        entry = {"policy": policy, "variant": dict(variant), **figures}
        entry["engine"] = "events" if reasons else "bulk"
        entry["event_engine_because"] = reasons
        if found := audits.get(cell):
            hit = sum(count > 0 for count in found)
            collided = share_interval(hit, len(found), confidence=confidence)
            entry["collided"] = collided.content()
            engine = engine_named(experiment.audit_engine)
            entry["audit_engine"] = engine_and_version(engine)
        cells.append(entry)
    return {
        "scenario": scenario,
        "confidence": confidence,
        "deadline_s": deadline_s,
        "antithetic": experiment.antithetic,
        "cells": cells,
        "differences": _differences(experiment, samples),
    }


def cell_label(cell: Mapping[str, Any]) -> str:
    """Return policy and varied inputs of a cell in one line."""
    varied = ", ".join(f"{key} = {value}" for key, value in cell["variant"].items())
    return f"{cell['policy']}, {varied}" if varied else str(cell["policy"])


def collisions(cell: Mapping[str, Any]) -> str:
    """Return in words how many audited replications of a cell collided."""
    count = cell["collided"]["count"]
    hits = round(cell["collided"]["estimate"] * count)
    return (
        f"{hits} of {count} replications audited with {cell['audit_engine']} collided"
    )


def _cell(
    experiment: Experiment, blocks: Path, cell: int, deadline_s: float | None
) -> tuple[Array, dict[str, Any]]:
    """Return the makespans [s] of a cell, NaN where it did not complete, and its figures."""
    confidence = experiment.precision.confidence
    parts, busy, waited, ends = [], [], [], []
    outcomes: Counter[str] = Counter()
    robots: tuple[str, ...] = ()
    for result in cell_blocks(blocks, cell):
        rows = result.rows
        done = rows.outcome == COMPLETED
        parts.append(rows.makespans_s())
        busy.append(rows.busy_ns[:, done].sum(axis=1, dtype=float))
        waited.append(rows.waited_ns[:, done].sum(axis=1, dtype=float))
        ends.append(rows.makespan_ns[done].sum(dtype=float))
        robots = rows.robots
        outcomes.update(rows.outcome.tolist())
    sample = np.concatenate(parts)
    completed = sample[np.isfinite(sample)]
    count = len(sample)

    def share(hits: int) -> dict[str, Any]:
        return share_interval(hits, count, confidence=confidence).content()

    figures: dict[str, Any] = {
        "replications": count,
        "outcomes": dict(sorted(outcomes.items())),
        "not_completed": share(count - len(completed)),
        "errors": outcomes[ERROR],
    }
    if len(completed) == 0:
        return sample, figures
    mirrored = experiment.antithetic and len(completed) == count > 1
    figures["makespan_s"] = mean_interval(
        completed, confidence=confidence, antithetic=mirrored
    ).content()
    figures["makespan_sd_s"] = float(np.std(completed, ddof=1)) if count > 1 else None
    for p in QUANTILES:
        figures[f"makespan_p{100 * p:.0f}_s"] = quantile_interval(
            completed, p, confidence=confidence
        ).content()
    if deadline_s is not None:
        figures["in_time"] = share(int(np.count_nonzero(completed <= deadline_s)))
    total = float(np.sum(ends))
    figures["utilisation"] = dict(
        zip(robots, (np.sum(busy, axis=0) / total).tolist(), strict=True)
    )
    mean_waits = np.sum(waited, axis=0) / NANOSECONDS / len(completed)
    figures["wait_s"] = {
        name: float(mean_waits[cause]) for cause, name in WAIT_COLUMNS.items()
    }
    return sample, figures


def _differences(
    experiment: Experiment, samples: Sequence[Array]
) -> list[dict[str, Any]]:
    """Return every policy against the first one, pair by pair, within the same variant."""
    reference = experiment.policies[0]
    found = []
    for k, (policy, variant) in enumerate(experiment.cells):
        first, second = samples[k], samples[k - k % len(experiment.policies)]
        both = np.isfinite(first) & np.isfinite(second)
        if policy == reference or not np.any(both):
            continue
        mirrored = experiment.antithetic and bool(np.all(both)) and len(both) > 1
        absolute = mean_interval(
            first[both] - second[both],
            confidence=experiment.precision.confidence,
            antithetic=mirrored,
        )
        found.append(
            {
                "policy": policy,
                "reference": reference,
                "variant": dict(variant),
                "makespan_s": absolute.content(),
                "relative": absolute.estimate / float(np.mean(second[both])),
            }
        )
    return found
