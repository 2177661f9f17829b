"""A plan without its geometry: all that matters once paths are known to be safe is time.

A timing graph is a TemporalPlanGraph that can be executed and sent anywhere, but not drawn: a
few hundred kilobytes for the plan of an assembly of hundreds of steps, less when contracted.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from planning.cell.body import Capsules, ConvexBody
from planning.cell.workcell import CellObject, Workcell
from planning.errors import OutputError
from planning.tasks.task_graph import Task
from scheduling.graph.temporal_plan_graph import NodeChain, TemporalPlanGraph
from twin.host.atomic import replacing
from twin.uncertainty.contraction import contract

_NO_BODY = ConvexBody(
    "none", np.zeros((0, 3)), Capsules(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
)
_CHAIN_ARRAYS = ("task", "skill", "duration", "planned_start")
_GRAPH_ARRAYS = ("edges", "cause", "dependencies", "slots")
_TASK_TEXTS = ("robot", "kind", "label", "object")


def timing_graph(
    tpg: TemporalPlanGraph, *, contracted: bool = False
) -> TemporalPlanGraph:
    """Return a plan without robots' models, shapes, poses and paths.

    Args:
        tpg: the plan.
        contracted: join nodes that nothing tells apart; right where messages take no time and
            nothing is drawn for single nodes.
    """
    graph = contract(tpg).tpg if contracted else tpg
    return replace(
        graph,
        cell=_bare_cell({item.name: item.kind for item in tpg.cell.objects}),
        tasks=tuple(replace(t, path=np.zeros((0, 0)), handlings=()) for t in tpg.tasks),
        chains=tuple(_bare_chain(chain) for chain in graph.chains),
        handlings=(),
        allowed=(),
    )


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
        cell=_bare_cell(dict(kinds)),
        tasks=tasks,
        chains=tuple(chains),
        handlings=(),
        allowed=(),
        **{name: arrays[name] for name in _GRAPH_ARRAYS},
    )


def _bare_cell(kinds: dict[str, str]) -> Workcell:
    items = tuple(
        CellObject(name, kind, np.zeros(3), np.eye(4), _NO_BODY)
        for name, kind in kinds.items()
    )
    return Workcell((), (), items)


def _bare_chain(chain: NodeChain) -> NodeChain:
    return replace(
        chain,
        start=np.zeros(0),
        waypoints=np.zeros((0, 0)),
        fraction=np.zeros(0),
        first=np.zeros(len(chain) + 1, dtype=np.int64),
    )
