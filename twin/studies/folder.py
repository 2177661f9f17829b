"""Folder of a study: file names, a manifest with the request of the study, and tables of results."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from pydantic import TypeAdapter

from planning.cell.workcell import Workcell
from planning.errors import OutputError, RequestError
from planning.files import replace_atomically
from scheduling.graph.temporal_plan_graph import MOTION_CONFLICT, TASK_DEPENDENCY
from twin.bulk.bulk_engine import contract_for_bulk
from twin.bulk.max_plus import policy_graph
from twin.durations.nanoseconds import NANOSECONDS
from twin.engine.execution_model import OTHER
from twin.recorders.run_tables import write_table
from twin.scenario.manifest import (
    MANIFEST,
    read_manifest,
    unchanged_base,
    write_manifest,
)
from twin.scenario.sections.scenario import Scenario
from twin.scenario.variations import Variant
from twin.studies.replications.block_results import TaskTally, cell_blocks, task_groups
from twin.studies.replications.experiment import Experiment
from twin.studies.replications.workload import Workload

PLANS, BLOCKS, AUDITS, PREVENTED = "plans", "blocks", "audits", "prevented"
REPLICATIONS, TASKS, EDGES = (
    "replications.parquet",
    "tasks.parquet",
    "edges.parquet",
)
PRODUCTS = "products.parquet"
SUMMARY, REPORT = "summary.json", "report.html"

CAUSES = {
    TASK_DEPENDENCY: "dependency",
    MOTION_CONFLICT: "conflict",
    OTHER: "turn",
}
"""Causes of edges, as ``edges.parquet`` names them."""

ROWS_A_GROUP = 20_000
"""Rows of a row group; fixed, so that the file does not depend on how blocks were cut."""


@dataclass(frozen=True)
class RefusedLayout:
    """A layout that cannot be planned.

    Attributes:
        layout: values of the keys that a plan depends on.
        reason: the reason.
    """

    layout: Variant
    reason: str


@dataclass(frozen=True)
class StudyRequest:
    """Request of a study: all of its options.

    Attributes:
        scenario: the studied scenario.
        base: base of relative paths in the scenario.
        experiment: policies, varied inputs, replications.
        candidates: number of shortcuts tried, for policies with shortcuts.
        deadline_s: deadline whose probability of being met is estimated [s], None for none.
        sobol_points: number of points of the sample for Sobol indices, 0 for none.
        plan: folder of the run whose plan is studied; empty if it was planned for the study.
        refused: requested layouts that cannot be planned.
        operated: whether replications replan after failures.

    Raises:
        RequestError: the deadline is no positive time, or the points are no power of 2.
    """

    scenario: Scenario
    base: Path
    experiment: Experiment
    candidates: int
    deadline_s: float | None = None
    sobol_points: int = 0
    plan: str = ""
    refused: tuple[RefusedLayout, ...] = ()
    operated: bool = False

    def __post_init__(self) -> None:
        deadline_s = self.deadline_s
        if deadline_s is not None and not 0 < deadline_s < math.inf:
            raise RequestError(
                f"a deadline must be more than 0 s, not {deadline_s:g} s"
            )
        if self.sobol_points:
            check_points(self.sobol_points)


def check_points(points: int) -> None:
    """Refuse a number of points that is no power of 2 greater than 1, with a RequestError."""
    if points < 2 or points & (points - 1):
        raise RequestError(
            f"Sobol indices need a power of 2 of points, not {points}",
            choices=("64", "128", "256", "512"),
        )


def write_request(
    folder: Path, request: StudyRequest, cell: Workcell, plans: Mapping[str, str]
) -> None:
    """Write ``manifest.json``: the data needed to understand, resume and repeat the study."""
    study = {
        "experiment": asdict(request.experiment),
        "shortcut_candidates": request.candidates,
        "deadline_s": request.deadline_s,
        "sobol_points": request.sobol_points,
        "plan": request.plan,
        "refused": [asdict(item) for item in request.refused],
        "plans_sha256": dict(plans),
        **({"operated": True} if request.operated else {}),
    }
    write_manifest(folder, request.scenario, cell, request.base, study=study)


def read_request(folder: Path) -> StudyRequest:
    """Return the request of a study.

    Raises:
        OutputError: the folder is not one of a study, or its manifest is damaged.
        RequestError: a file that the scenario names, or a version, has changed since.
    """
    scenario, manifest = read_manifest(folder, "folder of a study")
    try:
        base = unchanged_base(folder, manifest, scenario)
        return _request(scenario, base, manifest["study"])
    except (ValueError, KeyError, TypeError, OverflowError) as error:
        path = folder / MANIFEST
        raise OutputError(f"{path}: is no manifest of a study: {error}") from error


def _request(scenario: Scenario, base: Path, study: Mapping[str, Any]) -> StudyRequest:
    """Return the request of a study from its entry in the manifest.

    Raises:
        ValueError, KeyError, TypeError, OverflowError: the entry is damaged.
    """
    try:
        return StudyRequest(
            scenario,
            base,
            TypeAdapter(Experiment).validate_python(study["experiment"]),
            int(study["shortcut_candidates"]),
            None if (late := study["deadline_s"]) is None else float(late),
            int(study["sobol_points"]),
            str(study.get("plan", "")),
            TypeAdapter(tuple[RefusedLayout, ...]).validate_python(
                study.get("refused", ())
            ),
            bool(study.get("operated", False)),
        )
    except RequestError as error:  # of values that no command writes
        raise ValueError(error) from error


def require_same_plans(folder: Path, hashes: Mapping[str, str]) -> None:
    """Refuse plans that differ from those of the study's start.

    Raises:
        OutputError: a plan has changed; the message names it.
    """
    _, manifest = read_manifest(folder, "folder of a study")
    before = manifest["study"].get("plans_sha256", {})
    for name, digest in hashes.items():
        if before.get(name) != digest:
            raise OutputError(
                f"{folder / PLANS}: the plan {name!r} is not the one that the study began with"
            )


def require_same_study(folder: Path, scenario: Scenario) -> None:
    """Refuse a folder that holds a study of another scenario.

    Raises:
        RequestError: it does.
        OutputError: it holds none.
    """
    there = read_request(folder).scenario
    if there != scenario:
        raise RequestError(
            f"{folder} holds a study of scenario {there.name!r} as it was then, not of this"
            f" {scenario.name!r}; give another folder, or leave the scenario out to continue"
            " that one"
        )


def require_no_study(folder: Path | None, scenario: Scenario) -> None:
    """Refuse a folder that holds a study already.

    Raises:
        RequestError: it does; names how to resume it.
        OutputError: it holds something else.
    """
    if folder is not None and (folder / MANIFEST).exists():
        require_same_study(folder, scenario)
        raise RequestError(
            f"{folder} holds a study already: continue it with --resume {folder}, or give"
            " another folder"
        )


def write_replications(path: Path, experiment: Experiment, blocks: Path) -> None:
    """Write one row per replication, cell by cell, from the files of blocks.

    Only as many rows as make a row group are in memory at once.
    """
    tables = _groups(experiment, blocks)
    first = next(tables)
    with (
        replace_atomically(path) as temporary,
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
    """Return columns of a cell after those that identify the cell."""
    count = len(next(iter(columns.values())))
    names = {"policy": pa.array([policy] * count, pa.string())}
    names |= {key: pa.array([plain_value(v)] * count) for key, v in variant.items()}
    return pa.table({**names, **{key: pa.array(v) for key, v in columns.items()}})


def write_cells(
    path: Path, experiment: Experiment, columns: Iterable[Mapping[str, Any] | None]
) -> None:
    """Write a table of columns for each cell of an experiment that has any, if one has."""
    tables = [
        cell_table(policy, variant, own)
        for (policy, variant), own in zip(experiment.cells, columns, strict=True)
        if own is not None
    ]
    if tables:
        write_table(path, pa.concat_tables(tables, promote_options="permissive"))


def task_columns(load: Workload, tally: TaskTally) -> dict[str, Any]:
    """Return columns with one row per task: frequency of being critical, slack, start and end."""
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
            found = np.percentile(values, p, axis=0) if len(values) else np.nan
            columns[f"{name}_p{p}_s"] = np.broadcast_to(found / NANOSECONDS, len(tasks))
    return columns


def edge_columns(load: Workload, tally: TaskTally) -> dict[str, Any]:
    """Return columns with one row per type-2 edge: tasks, cause, frequency of being critical."""
    tpg, model = load.tpg, load.execution
    if not load.reasons:
        tpg = contract_for_bulk(tpg, model).tpg
    graph = policy_graph(tpg, model.policy)
    task = np.concatenate([own.task for own in tpg.chains])
    target = np.repeat(np.arange(len(task)), np.diff(graph.edge_first))
    return {
        "first_task": task[graph.source],
        "then_task": task[target],
        "cause": [CAUSES[cause] for cause in graph.cause.tolist()],
        "criticality": tally.critical_edges / max(tally.count, 1),
    }


def plain_value(value: Any) -> Any:
    """Return a value for a column or an axis: anything but numbers and strings as JSON."""
    return value if isinstance(value, int | float | str) else json.dumps(value)
