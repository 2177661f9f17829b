"""Task graph (APEX-MR IV-A): tasks of robots, their final configurations, and their dependencies.

The graph precedes the planning of simultaneous motion, so it contains no conflicts of motions.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import networkx as nx
import numpy as np

from planning.tasks.task import Task
from planning.transforms import Indices

ORDER, DEPENDENCY = "order", "dependency"
"""Kinds of edges: order of the tasks of one robot, and dependency on a task of any robot."""

if TYPE_CHECKING:
    TaskGraph = nx.DiGraph[int]
else:
    TaskGraph = nx.DiGraph


def task_graph(tasks: Iterable[Task], dependencies: Indices) -> TaskGraph:
    """Return the task graph of tasks.

    Nodes are the indices of tasks. Their attributes are the ``task`` and its ``target``: the configuration at which the
    robot ends the task, shape (n,), or None for a task without a path. An edge from a to b says that a must be
    complete before b starts. Its ``kind`` is ORDER or DEPENDENCY; DEPENDENCY if it is both.

    Args:
        tasks: in an order in which each robot can do its own.
        dependencies: pairs (a, b) of indices: a must be complete before b starts, shape (e, 2).
    """
    graph: TaskGraph = nx.DiGraph()
    last: dict[str, int] = {}
    for task in tasks:
        target = task.path[-1] if len(task.path) else None
        graph.add_node(task.index, task=task, target=target)
        if task.robot in last:
            graph.add_edge(last[task.robot], task.index, kind=ORDER)
        last[task.robot] = task.index
    for first, second in np.asarray(dependencies).reshape(-1, 2).tolist():
        graph.add_edge(first, second, kind=DEPENDENCY)
    return graph
