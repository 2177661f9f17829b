"""The tidy tables of a study: ``replications.parquet``, ``tasks.parquet``, ``edges.parquet``."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from scheduling.graph.temporal_plan_graph import (
    MOTION_CONFLICT,
    TASK_DEPENDENCY,
)
from twin.durations.model import NANOSECONDS, Nanoseconds
from twin.engine.bulk.bulk_engine import bulk_contraction
from twin.engine.bulk.max_plus import OTHER, policy_graph
from twin.host.guard import replacing
from twin.recorders.observers import write_table
from twin.scenario.variations import Variant
from twin.study.replications.block_results import (
    TaskTally,
    cell_blocks,
    task_groups,
)
from twin.study.replications.statistics import (
    Experiment,
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
    names |= {key: pa.array([plain(v)] * count) for key, v in variant.items()}
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


def edge_columns(load: Workload, tally: TaskTally) -> dict[str, Any]:
    """Return a row a type-2 edge: which tasks it joins, why, and how often it was critical."""
    tpg, model = load.tpg, load.execution
    if not load.reasons:
        tpg = bulk_contraction(tpg, model).tpg
    graph = policy_graph(tpg, model.policy)
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


def plain(value: Any) -> Any:
    """Return a value that a column or an axis can hold: what is no number or word as JSON."""
    return value if isinstance(value, int | float | str) else json.dumps(value)
