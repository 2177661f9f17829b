"""Timing graphs on disk, one small file each, for benchmarks of the engines."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from planning.errors import OutputError
from planning.tasks.task import Task
from scheduling.graph.temporal_plan_graph import NodeChain, TemporalPlanGraph
from twin.host.atomic import replacing
from twin.study.replications.workload import bare_cell

_CHAIN_ARRAYS = ("task", "skill", "duration", "planned_start")
_GRAPH_ARRAYS = ("edges", "cause", "dependencies", "slots")
_TASK_TEXTS = ("robot", "kind", "label", "object")


def save_timing_graph(path: Path, graph: TemporalPlanGraph) -> None:
    """Write a timing graph as one compressed ``.npz`` file.

    Raises:
        OutputError: it cannot be written.
    """
    arrays: dict[str, Any] = {name: getattr(graph, name) for name in _GRAPH_ARRAYS}
    arrays["robots"] = np.array([chain.robot for chain in graph.chains], dtype=str)
    for k, chain in enumerate(graph.chains):
        arrays |= {f"{name}_{k}": getattr(chain, name) for name in _CHAIN_ARRAYS}
    for name in _TASK_TEXTS:
        values = [getattr(task, name) or "" for task in graph.tasks]
        arrays[f"task_{name}"] = np.array(values, dtype=str)
    arrays["task_index"] = np.array([t.index for t in graph.tasks], dtype=np.int64)
    arrays["task_step"] = np.array([t.step for t in graph.tasks], dtype=np.int64)
    items = graph.cell.objects
    arrays["object_name"] = np.array([item.name for item in items], dtype=str)
    arrays["object_kind"] = np.array([item.kind for item in items], dtype=str)
    with replacing(path) as temporary:
        np.savez_compressed(temporary, **arrays)


def load_timing_graph(path: Path) -> TemporalPlanGraph:
    """Return the graph that ``save_timing_graph`` wrote.

    Raises:
        OutputError: it is missing or damaged.
    """
    try:
        with np.load(path, allow_pickle=False) as arrays:
            return _read(arrays)
    except (OSError, ValueError, KeyError) as error:
        raise OutputError(f"{path}: is no timing graph: {error}") from error


def _read(arrays: Any) -> TemporalPlanGraph:
    texts = [arrays[f"task_{name}"].tolist() for name in _TASK_TEXTS]
    numbers = [arrays["task_index"].tolist(), arrays["task_step"].tolist()]
    tasks = tuple(
        Task(index, robot, kind, step, label, np.zeros((0, 0)), (), name or None)
        for index, step, robot, kind, label, name in zip(*numbers, *texts, strict=True)
    )
    chains = []
    for k, robot in enumerate(arrays["robots"].tolist()):
        own = {name: arrays[f"{name}_{k}"] for name in _CHAIN_ARRAYS}
        count = len(own["task"])
        chains.append(
            NodeChain(
                robot=robot,
                start=np.zeros(0),
                waypoints=np.zeros((0, 0)),
                fraction=np.zeros(0),
                first=np.zeros(count + 1, dtype=np.int64),
                **own,
            )
        )
    kinds = zip(
        arrays["object_name"].tolist(), arrays["object_kind"].tolist(), strict=True
    )
    return TemporalPlanGraph(
        cell=bare_cell(dict(kinds)),
        tasks=tasks,
        chains=tuple(chains),
        handlings=(),
        allowed=(),
        **{name: arrays[name] for name in _GRAPH_ARRAYS},
    )
