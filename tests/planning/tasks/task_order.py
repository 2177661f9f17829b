"""Which task comes before which, as a graph."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import networkx as nx

from planning.tasks.task import Task


def task_order(
    tasks: Sequence[Task], dependencies: Iterable[tuple[int, int]]
) -> nx.DiGraph:
    """Return tasks by index, after what they wait for and after the one before of their robot."""
    graph = nx.DiGraph([(int(a), int(b)) for a, b in dependencies])
    for robot in {task.robot for task in tasks}:
        nx.add_path(graph, [task.index for task in tasks if task.robot == robot])
    assert nx.is_directed_acyclic_graph(graph)
    assert set(graph) == {task.index for task in tasks}
    return graph
