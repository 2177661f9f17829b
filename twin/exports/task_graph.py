"""The task graph of APEX-MR IV-A as GraphML: tasks, where objects rest, and what waits for what.

It is the input of scheduling: unlike the temporal plan graph it knows no motion conflicts.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

import networkx as nx

from scheduling.graph.temporal_plan_graph import NodeHandling, TemporalPlanGraph
from twin.exports.graphs import Graph, graphml, task_attributes, task_name
from twin.exports.recorded_run import RecordedRun


def task_graph_files(run: RecordedRun) -> Mapping[str, bytes]:
    """Return ``task_graph.graphml``."""
    return {"task_graph.graphml": graphml(task_graph(run.tpg, run.scenario))}


def task_graph(tpg: TemporalPlanGraph, name: str = "") -> Graph:
    """Return the task graph of a plan, with plain values as attributes.

    Nodes are tasks (``type`` task, with the attributes of the temporal plan graph's) and the
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
    last: dict[str, str] = {}
    for task in tpg.tasks:
        node = task_name(task.index)
        graph.add_node(node, type="task", **task_attributes(tpg, task.index))
        if task.robot in last:
            graph.add_edge(last[task.robot], node, kind="order")
        last[task.robot] = node
    for first, second in tpg.dependencies.tolist():
        graph.add_edge(task_name(first), task_name(second), kind="dependency")
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
        index = _task_of(tpg, handling)
        name, taker = handling.object, handling.holder
        if holders.get(name) is None and taker is not None:
            resting = f"{name} {stays[name] - 1}"
            graph.add_edge(resting, task_name(index), kind="attached")
        else:
            stay = add_stay(name, taker, handling.pose[:3, 3].tolist())
            graph.add_edge(task_name(index), stay, kind="detached")
            later = (t for t in tpg.tasks if t.robot == taker and t.index > index)
            if (task := next(later, None)) is not None:
                graph.add_edge(stay, task_name(task.index), kind="attached")
        holders[name] = taker


def _task_of(tpg: TemporalPlanGraph, handling: NodeHandling) -> int:
    return int(tpg.chains[handling.robot].task[handling.node])
