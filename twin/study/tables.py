"""The tidy tables of a study: ``replications.parquet``, ``tasks.parquet``, ``edges.parquet``.

Figures of a study: ``summary.json``.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from planning.transforms import Array
from scheduling.graph.temporal_plan_graph import (
    MOTION_CONFLICT,
    TASK_DEPENDENCY,
    TemporalPlanGraph,
)
from twin.audit.worlds.world import engine_and_version, engine_named
from twin.durations import NANOSECONDS, Nanoseconds
from twin.engine.bulk.bulk_engine import bulk_contraction
from twin.engine.bulk.max_plus import OTHER, policy_graph
from twin.host.guard import replacing
from twin.recorders.observers import write_table
from twin.run.policies import PLAIN_POLICIES
from twin.scenario.variations import Variant
from twin.study.replications.block_results import (
    COMPLETED,
    ERROR,
    WAIT_COLUMNS,
    ProductTimes,
    TaskTally,
    cell_blocks,
    task_groups,
)
from twin.study.replications.statistics import (
    Experiment,
    mean_interval,
    quantile_interval,
    share_interval,
)
from twin.study.replications.workload import Workload

CAUSES = {
    TASK_DEPENDENCY: "dependency",
    MOTION_CONFLICT: "conflict",
    OTHER: "turn",
}
"""Causes of edges, as ``edges.parquet`` names them."""

ROWS_A_GROUP = 20_000
"""Rows of a row group; fixed, so that the file does not depend on how blocks were cut."""


def write_replications(path: Path, experiment: Experiment, blocks: Path) -> None:
    """Write one row a replication, cell by cell, from the files of blocks.

    Only as many rows as make a row group are in memory at once.
    """
    tables = _groups(experiment, blocks)
    first = next(tables)
    with (
        replacing(path) as temporary,
        pq.ParquetWriter(temporary, first.schema, compression="zstd") as writer,
    ):
        for table in chain([first], tables):
            writer.write_table(table)


def _groups(experiment: Experiment, blocks: Path) -> Iterator[pa.Table]:
    waiting: list[pa.Table] = []
    for cell, (policy, variant) in enumerate(experiment.cells):
        for result in cell_blocks(blocks, cell):
            waiting.append(cell_table(policy, variant, result.rows.columns()))
            while sum(len(table) for table in waiting) >= ROWS_A_GROUP:
                joined = pa.concat_tables(waiting, promote_options="permissive")
                yield joined.slice(0, ROWS_A_GROUP)
                waiting = [joined.slice(ROWS_A_GROUP)]
    if waiting:
        yield pa.concat_tables(waiting, promote_options="permissive")


def cell_table(policy: str, variant: Variant, columns: Mapping[str, Any]) -> pa.Table:
    """Return columns of a cell behind those that name the cell."""
    count = len(next(iter(columns.values())))
    names = {"policy": pa.array([policy] * count, pa.string())}
    names |= {key: pa.array([_plain(v)] * count) for key, v in variant.items()}
    return pa.table({**names, **{key: pa.array(v) for key, v in columns.items()}})


def write_cells(
    path: Path, experiment: Experiment, columns: Iterable[Mapping[str, Any]]
) -> None:
    """Write a table of columns for each cell of an experiment."""
    tables = [
        cell_table(policy, variant, own)
        for (policy, variant), own in zip(experiment.cells, columns, strict=True)
    ]
    write_tables(path, tables)


def write_tables(path: Path, tables: Sequence[pa.Table]) -> None:
    """Write tables of cells as one."""
    write_table(path, pa.concat_tables(tables, promote_options="permissive"))


def task_columns(load: Workload, tally: TaskTally) -> dict[str, Any]:
    """Return a row a task: how often it was critical, its slack, when it starts and ends."""
    groups = task_groups(load.tpg)
    tasks = [load.tpg.tasks[index] for index in groups.task.tolist()]
    columns: dict[str, Any] = {
        "task": groups.task,
        "robot": [task.robot for task in tasks],
        "kind": [task.kind for task in tasks],
        "step": [task.step for task in tasks],
        "label": [task.label for task in tasks],
        "criticality": tally.critical / max(tally.count, 1),
        "slack_mean_s": tally.slack_ns / NANOSECONDS / max(tally.count, 1),
    }
    for name, values in (("start", tally.start_ns), ("end", tally.end_ns)):
        for p in (10, 50, 90):
            columns[f"{name}_p{p}_s"] = _percentile(values, p, len(tasks))
    return columns


def product_columns(times: ProductTimes, due_s: Sequence[float] = ()) -> dict[str, Any]:
    """Return a row a product: when it is complete, and how likely after it is due."""
    begin = times.product_begin_ns / NANOSECONDS
    end = times.product_end_ns / NANOSECONDS
    count = len(end)
    columns: dict[str, Any] = {
        "product": np.arange(1, count + 1),
        "begin_mean_s": begin.mean(axis=1),
        "end_mean_s": end.mean(axis=1),
        "cycle_mean_s": (end - begin).mean(axis=1),
    }
    for p in (5, 50, 95):
        columns[f"end_p{p}_s"] = np.percentile(end, p, axis=1)
    if len(due_s):
        late = end - np.asarray(due_s)[:, None]
        columns["due_s"] = np.asarray(due_s, dtype=float)
        columns["lateness_mean_s"] = late.mean(axis=1)
        columns["late"] = (late > 0).mean(axis=1)
    return columns


def edge_columns(load: Workload, tally: TaskTally) -> dict[str, Any]:
    """Return a row a type-2 edge: which tasks it joins, why, and how often it was critical."""
    tpg: TemporalPlanGraph = (
        load.tpg if load.reasons else bulk_contraction(load.tpg).tpg
    )
    graph = policy_graph(tpg, load.execution.policy)
    task = np.concatenate([own.task for own in tpg.chains])
    target = np.repeat(np.arange(len(task)), np.diff(graph.edge_first))
    return {
        "first_task": task[graph.source],
        "then_task": task[target],
        "cause": [CAUSES[cause] for cause in graph.cause.tolist()],
        "criticality": tally.critical_edges / max(tally.count, 1),
    }


def _percentile(values: Nanoseconds, p: int, count: int) -> Any:
    if len(values) == 0:
        return np.full(count, np.nan)
    return np.percentile(values, p, axis=0) / NANOSECONDS


def _plain(value: Any) -> Any:
    """Return a value that a column can hold: what is no number or word as JSON."""
    if isinstance(value, bool | int | float | str):
        return value
    return json.dumps(value)


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
    """Return policies against each other, pair by pair, within the same variant.

    Each is compared with the first one, and one with shortcuts with the best of those without, too.
    """
    found = []
    count = len(experiment.policies)
    for k, (policy, variant) in enumerate(experiment.cells):
        begin = k - k % count
        for other in dict.fromkeys((begin, _best_plain(experiment, samples, k))):
            first, second = samples[k], samples[other]
            both = np.isfinite(first) & np.isfinite(second)
            if other == k or not np.any(both):
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
                    "reference": experiment.policies[other - begin],
                    "variant": dict(variant),
                    "makespan_s": absolute.content(),
                    "relative": absolute.estimate / float(np.mean(second[both])),
                }
            )
    return found


def _best_plain(experiment: Experiment, samples: Sequence[Array], cell: int) -> int:
    """Return the quickest cell without shortcuts beside one with them; else the first one."""
    begin = cell - cell % len(experiment.policies)
    if experiment.cells[cell][0] in PLAIN_POLICIES:
        return begin
    means = {
        begin + k: float(np.mean(samples[begin + k]))
        for k, policy in enumerate(experiment.policies)
        if policy in PLAIN_POLICIES and np.all(np.isfinite(samples[begin + k]))
    }
    return min(means, key=lambda k: means[k], default=begin)
