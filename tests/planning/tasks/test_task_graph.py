"""The task graph: orders, objects and who is told when it is wrong."""

from __future__ import annotations

import networkx as nx
import numpy as np
import pytest

from planning.errors import PlanInvariantError
from planning.tasks.task_graph import (
    Handling,
    Task,
    build_task_graph,
    object_node,
    task_node,
)
from planning.transforms import identity, translation


def task(index: int, robot: str, kind: str, *handlings: Handling) -> Task:
    path = np.zeros((3, 6))
    return Task(index, robot, kind, 1, f"{kind} {index}", path, handlings)


def handover_tasks() -> list[Task]:
    """Ada picks, hands over to Bob, who places."""
    return [
        task(0, "ada", "pick", Handling("b", 1, "ada", identity())),
        task(1, "bob", "transit"),
        task(2, "ada", "handover", Handling("b", 1, "bob", identity())),
        task(3, "bob", "transit"),
        task(4, "ada", "transit"),
        task(5, "bob", "place-up", Handling("b", 1, None, translation(1, 2, 3))),
    ]


DEPENDENCIES = [(1, 2), (2, 3)]


def test_consecutive_tasks_of_a_robot_are_ordered() -> None:
    graph = build_task_graph(handover_tasks(), DEPENDENCIES)
    order = {(a[1], b[1]) for a, b, kind in graph.edges(data="kind") if kind == "order"}
    assert order == {(0, 2), (2, 4), (1, 3), (3, 5)}


def test_an_object_passes_from_place_to_place() -> None:
    graph = build_task_graph(handover_tasks(), DEPENDENCIES)
    steps = [
        (object_node("b", 0), task_node(0), "attached"),
        (task_node(2), object_node("b", 1), "detached"),
        (object_node("b", 1), task_node(3), "attached"),
        (task_node(5), object_node("b", 2), "detached"),
    ]
    for a, b, kind in steps:
        assert graph.edges[a, b]["kind"] == kind
    assert graph.nodes[object_node("b", 2)]["pose"][:3, 3] == pytest.approx([1, 2, 3])
    assert graph.number_of_nodes() == 6 + 3
    assert nx.is_directed_acyclic_graph(graph)


def test_dependencies_become_edges() -> None:
    graph = build_task_graph(handover_tasks(), np.array(DEPENDENCIES))
    assert graph.edges[task_node(1), task_node(2)]["kind"] == "dependency"
    assert nx.has_path(graph, task_node(0), task_node(5))


def test_a_cycle_is_named() -> None:
    with pytest.raises(PlanInvariantError, match="cycle") as caught:
        build_task_graph(handover_tasks(), [*DEPENDENCIES, (5, 1)])
    assert "bob: place-up 5" in str(caught.value)


def test_a_dependency_on_nothing_is_refused() -> None:
    with pytest.raises(PlanInvariantError, match="task 9"):
        build_task_graph(handover_tasks(), [(9, 1)])


def test_only_the_holder_handles_an_object() -> None:
    tasks = [
        task(0, "ada", "pick", Handling("b", 1, "ada", identity())),
        task(1, "bob", "place-down", Handling("b", 1, None, identity())),
    ]
    with pytest.raises(PlanInvariantError, match="which ada holds"):
        build_task_graph(tasks, [])
    with pytest.raises(PlanInvariantError, match="which nobody holds"):
        build_task_graph([tasks[1]], [])
