"""The temporal plan graph as GraphML and DOT.

By default a node is a task, and an edge joins two tasks when any of their nodes are joined; as a
robot may wait in the middle of a task, two tasks may then wait for each other. With ``--nodes``
every node is there, and the graph has no cycles.
"""

from __future__ import annotations

from collections.abc import Mapping
from io import BytesIO
from typing import TYPE_CHECKING, Any

import networkx as nx

from scheduling.graph.temporal_plan_graph import (
    MOTION_CONFLICT,
    TASK_DEPENDENCY,
    TemporalPlanGraph,
)
from twin.durations.nanoseconds import NANOSECONDS
from twin.exports.recorded_run import RecordedRun
from twin.run.lanes import CAUSES, LANE_COLOURS, OTHER_COLOUR

if TYPE_CHECKING:
    Graph = nx.DiGraph[str]
else:
    Graph = nx.DiGraph

SAME_ROBOT = "same robot"
"""Cause of type-1 edges."""

DEPENDENCY, CONFLICT = CAUSES[TASK_DEPENDENCY], CAUSES[MOTION_CONFLICT]

_STYLES = {SAME_ROBOT: "bold", DEPENDENCY: "solid", CONFLICT: "dashed"}


def graphml_files(run: RecordedRun, *, nodes: bool) -> Mapping[str, bytes]:
    """Return ``tpg.graphml``."""
    return {"tpg.graphml": graphml(run_graph(run, nodes=nodes))}


def graphml(graph: Graph) -> bytes:
    """Return a graph as the content of a GraphML file."""
    buffer = BytesIO()
    nx.write_graphml(graph, buffer)
    return buffer.getvalue() + b"\n"


def dot_files(run: RecordedRun, *, nodes: bool) -> Mapping[str, bytes]:
    """Return ``tpg.dot``: a cluster a robot, tasks in the colours of the Gantt chart."""
    return {"tpg.dot": _dot(run_graph(run, nodes=nodes), run.scenario).encode()}


def run_graph(run: RecordedRun, *, nodes: bool) -> Graph:
    """Return the graph that was executed, with plain values as attributes.

    Attributes of nodes: robot, task, kind, step, label, object, duration_s (nominal), and start_s
    and end_s where it started and was completed; of single nodes also node, skill and
    planned_start_s. Attributes of edges: type (1 or 2), cause, and for tasks count, the number
    of edges between their nodes, and conflicts, how many of them are motion conflicts.

    Args:
        run: the run.
        nodes: every node, not one a task.
    """
    graph: Graph = nx.DiGraph(name=run.scenario)
    (_add_nodes if nodes else _add_tasks)(graph, run)
    return graph


def _add_nodes(graph: Graph, run: RecordedRun) -> None:
    tpg = run.tpg
    for chain, times in zip(tpg.chains, run.node_times_ns, strict=True):
        for k in range(len(chain)):
            index = int(chain.task[k])
            graph.add_node(
                f"{chain.robot}/{k}",
                **task_attributes(tpg, index),
                node=k,
                skill=bool(chain.skill[k]),
                duration_s=float(chain.duration[k]),
                planned_start_s=float(chain.planned_start[k]),
                **_executed(int(times[0][k]), int(times[1][k])),
            )
            if k:
                graph.add_edge(
                    f"{chain.robot}/{k - 1}",
                    f"{chain.robot}/{k}",
                    type=1,
                    cause=SAME_ROBOT,
                )
    for (before, source, after, target), cause in _edges(tpg):
        graph.add_edge(
            f"{tpg.chains[before].robot}/{source}",
            f"{tpg.chains[after].robot}/{target}",
            type=2,
            cause=CAUSES[cause],
        )


def _add_tasks(graph: Graph, run: RecordedRun) -> None:
    tpg = run.tpg
    for chain, times in zip(tpg.chains, run.node_times_ns, strict=True):
        previous = None
        for index in dict.fromkeys(chain.task.tolist()):
            mine = chain.task == index
            name = task_name(index)
            graph.add_node(
                name,
                **task_attributes(tpg, index),
                nodes=int(mine.sum()),
                duration_s=float(chain.duration[mine].sum()),
                **_executed(int(times[0][mine][0]), int(times[1][mine][-1])),
            )
            if previous is not None:
                graph.add_edge(
                    previous, name, type=1, cause=SAME_ROBOT, count=1, conflicts=0
                )
            previous = name
    for (before, source, after, target), cause in _edges(tpg):
        first = task_name(int(tpg.chains[before].task[source]))
        second = task_name(int(tpg.chains[after].task[target]))
        conflict = int(cause == MOTION_CONFLICT)
        if not graph.has_edge(first, second):
            graph.add_edge(first, second, type=2, cause=CONFLICT, count=0, conflicts=0)
        edge = graph.edges[first, second]
        edge["count"] += 1
        edge["conflicts"] += conflict
        if not conflict:
            edge["cause"] = DEPENDENCY


def _edges(tpg: TemporalPlanGraph) -> list[tuple[list[int], int]]:
    return list(zip(tpg.edges.tolist(), tpg.cause.tolist(), strict=True))


def task_name(index: int) -> str:
    """Return the name of the node that stands for a task."""
    return f"task {index}"


def task_attributes(tpg: TemporalPlanGraph, index: int) -> dict[str, Any]:
    """Return what is known of a task, as attributes of a node."""
    task = tpg.tasks[index]
    return {
        "robot": task.robot,
        "task": index,
        "kind": task.kind,
        "step": task.step,
        "label": task.label,
        "object": task.object or "",
    }


def _executed(start_ns: int, end_ns: int) -> dict[str, float]:
    """Return when something started and was completed, nothing where it did not [s]."""
    out = {}
    if start_ns >= 0:
        out["start_s"] = start_ns / NANOSECONDS
    if end_ns >= 0:
        out["end_s"] = end_ns / NANOSECONDS
    return out


def _dot(graph: Graph, name: str) -> str:
    lines = [
        f"digraph {_quoted(name)} {{",
        "  rankdir=LR;",
        '  node [shape=box, style="rounded,filled", fontname="Helvetica", fontsize=10];',
        '  edge [fontname="Helvetica", fontsize=8, color="#555555"];',
    ]
    robots = dict.fromkeys(data["robot"] for _, data in graph.nodes(data=True))
    for k, robot in enumerate(robots):
        lines.append(f"  subgraph cluster_{k} {{")
        lines.append(
            f'    label={_quoted(robot)}; fontname="Helvetica"; labeljust=l; color="#bbbbbb";'
        )
        for node, data in graph.nodes(data=True):
            if data["robot"] == robot:
                lines.append(f"    {_quoted(node)} [{_node_style(node, data)}];")
        lines.append("  }")
    for first, second, data in graph.edges(data=True):
        style = [f"style={_STYLES[data['cause']]}"]
        if data["type"] == 2:
            style += [f"tooltip={_quoted(data['cause'])}", "constraint=false"]
            if data.get("count", 1) > 1:
                style.append(f"label={_quoted(str(data['count']))}")
        lines.append(f"  {_quoted(first)} -> {_quoted(second)} [{', '.join(style)}];")
    return "\n".join([*lines, "}", ""])


def _node_style(node: str, data: Mapping[str, Any]) -> str:
    red, green, blue = LANE_COLOURS.get(data["kind"], OTHER_COLOUR)
    text = data["label"] if "node" not in data else f"{data['label']}\n{node}"
    hint = f"{data['kind']}, step {data['step']}, {data['duration_s']:.2f} s"
    return f'label={_quoted(text)}, tooltip={_quoted(hint)}, fillcolor="#{red:02x}{green:02x}{blue:02x}"'


def _quoted(text: str) -> str:
    """Return a DOT string: only quotes, backslashes and line ends mean anything in it."""
    escaped = text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
    return f'"{escaped}"'
