"""Export of the temporal plan graph (APEX-MR, section IV-C) and the task graph (section IV-A) as GraphML.

By default, each node of the exported plan graph is a task, with an edge between two tasks if there is an edge between
any of their nodes. This graph can have cycles, because a robot may wait in the middle of a task. With ``--nodes``,
every node of the plan is exported, and there are no cycles. The task graph has the order and the dependencies of
tasks, without motion conflicts. It also has a node for each place at which an object is at rest or held.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from io import BytesIO
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import networkx as nx
import numpy as np

from planning.tasks.task_graph import task_graph as planned_graph
from scheduling.graph.temporal_plan_graph import (
    MOTION_CONFLICT,
    TASK_DEPENDENCY,
    TemporalPlanGraph,
)
from twin.activities.activities import CAUSES, SAME_ROBOT
from twin.durations.nanoseconds import NANOSECONDS
from twin.trial.run_result import RunResult

if TYPE_CHECKING:
    Graph = nx.DiGraph[str]
else:
    Graph = nx.DiGraph

DEPENDENCY, CONFLICT = CAUSES[TASK_DEPENDENCY], CAUSES[MOTION_CONFLICT]


def graphml_files(run: RunResult, *, nodes: bool) -> Mapping[str, bytes]:
    """Return ``tpg.graphml``."""
    return {"tpg.graphml": graphml(_run_graph(run, nodes=nodes))}


def graphml(graph: Graph) -> bytes:
    """Return a graph as the content of a GraphML file."""
    buffer = BytesIO()
    nx.write_graphml(graph, buffer)
    return buffer.getvalue() + b"\n"


def _run_graph(run: RunResult, *, nodes: bool) -> Graph:
    """Return the executed graph, with plain values as attributes.

    Attributes of nodes: robot, task, kind, step, label, object, duration_s (nominal), and start_s
    and end_s where it started and was completed; of single nodes also node, skill and
    planned_start_s. Attributes of edges: type (1 or 2), cause, and for tasks count, the number
    of edges between their nodes, and conflicts, how many of them are motion conflicts.

    Args:
        run: the run.
        nodes: one graph node for every plan node, in place of one per task.
    """
    tpg = run.tpg
    graph: Graph = nx.DiGraph(name=run.name)
    names: list[list[str]] = []
    once = {} if nodes else {"count": 1, "conflicts": 0}
    for chain, (start, end) in zip(tpg.chains, run.node_times_ns, strict=True):
        opens = np.diff(chain.task, prepend=-1) != 0
        opens |= nodes
        names.append([])
        for low, high in pairwise([*np.flatnonzero(opens).tolist(), len(chain)]):
            index = int(chain.task[low])
            name = f"{chain.robot}/{low}" if nodes else _task_name(index)
            own: dict[str, Any] = {"nodes": high - low}
            if nodes:
                own = {"node": low, "skill": bool(chain.skill[low])}
            own["duration_s"] = float(chain.duration[low:high].sum())
            if nodes:
                own["planned_start_s"] = float(chain.planned_start[low])
            if start[low] >= 0:
                own["start_s"] = int(start[low]) / NANOSECONDS
            if end[high - 1] >= 0:
                own["end_s"] = int(end[high - 1]) / NANOSECONDS
            graph.add_node(name, **_task_attributes(tpg, index), **own)
            if low:
                graph.add_edge(names[-1][-1], name, type=1, cause=SAME_ROBOT, **once)
            names[-1] += [name] * (high - low)
    for edge, cause in zip(tpg.edges.tolist(), tpg.cause.tolist(), strict=True):
        before, source, after, target = edge
        ends = names[before][source], names[after][target]
        if nodes:
            graph.add_edge(*ends, type=2, cause=CAUSES[cause])
            continue
        if not graph.has_edge(*ends):
            graph.add_edge(*ends, type=2, cause=CONFLICT, count=0, conflicts=0)
        data = graph.edges[ends]
        data["count"] += 1
        data["conflicts"] += int(cause == MOTION_CONFLICT)
        if cause != MOTION_CONFLICT:
            data["cause"] = DEPENDENCY
    return graph


def _task_name(index: int) -> str:
    """Return the node name of a task."""
    return f"task {index}"


def _task_attributes(tpg: TemporalPlanGraph, index: int) -> dict[str, Any]:
    """Return the node attributes of a task."""
    task = tpg.tasks[index]
    known = {key: getattr(task, key) for key in ("kind", "step", "label")}
    return {"robot": task.robot, "task": index, **known, "object": task.object or ""}


def task_graph_files(run: RunResult) -> Mapping[str, bytes]:
    """Return ``task_graph.graphml``."""
    return {"task_graph.graphml": graphml(task_graph(run.tpg, run.name))}


def task_graph(tpg: TemporalPlanGraph, name: str = "") -> Graph:
    """Return the task graph of a plan, with plain values as attributes.

    Nodes are tasks (``type`` task, with the attributes of the temporal plan graph's, and the
    configuration at which the robot ends it as ``target_rad_or_m``) and the
    stays of objects (``type`` object: at the start, in the hands of whom it is given to, in its
    place), with ``object``, ``holder`` and the position ``x_m``, ``y_m``, ``z_m`` in the world or
    in the holder's flange. Edges have a ``kind``: ``order`` between consecutive tasks of a robot,
    ``dependency`` from a task to one that waits for it, ``attached`` from an object to the task
    that begins with it in hand, ``detached`` from a task to the object that it leaves behind,
    hands over or lets come up.

    Args:
        tpg: the plan.
        name: of the graph.
    """
    graph: Graph = nx.DiGraph(name=name)
    tasks = planned_graph(tpg.tasks, tpg.dependencies)
    for index, data in tasks.nodes(data=True):
        target = data["target"]
        target_text = "" if target is None else " ".join(map(repr, target.tolist()))
        about = {**_task_attributes(tpg, index), "target_rad_or_m": target_text}
        graph.add_node(_task_name(index), type="task", **about)
    for first, second, data in tasks.edges(data=True):
        graph.add_edge(_task_name(first), _task_name(second), kind=data["kind"])
    _add_objects(graph, tpg)
    return graph


def _add_objects(graph: Graph, tpg: TemporalPlanGraph) -> None:
    """Add a node for every stay of an object, with its edges."""
    stays: Counter[str] = Counter()
    holders: dict[str, str | None] = {}

    def add_stay(name: str, holder: str | None, position: list[float]) -> str:
        node = f"{name} {stays[name]}"
        stays[name] += 1
        x, y, z = position
        graph.add_node(
            node, type="object", object=name, holder=holder or "", x_m=x, y_m=y, z_m=z
        )
        return node

    for item in tpg.cell.objects:
        if not item.later:
            add_stay(item.name, None, item.start[:3, 3].tolist())
    for handling in tpg.handlings:
        index = tpg.task_of(handling).index
        name, taker = handling.object, handling.holder
        if holders.get(name) is None and taker is not None:
            resting = f"{name} {stays[name] - 1}"
            graph.add_edge(resting, _task_name(index), kind="attached")
        else:
            stay = add_stay(name, taker, handling.pose[:3, 3].tolist())
            graph.add_edge(_task_name(index), stay, kind="detached")
            later = (t for t in tpg.tasks if t.robot == taker and t.index > index)
            if (task := next(later, None)) is not None:
                graph.add_edge(stay, _task_name(task.index), kind="attached")
        holders[name] = taker
