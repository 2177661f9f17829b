"""Tasks, what may touch whom during them, and the graph that orders them (APEX-MR IV-A)."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import networkx as nx

from planning.errors import PlanInvariantError
from planning.transforms import Array, Indices, Transform

TRANSIT = "transit"
SKILLS = (
    "pick",
    "place-down",
    "place-up",
    "handover",
    "support-bottom",
    "support-top",
)


@dataclass(frozen=True)
class Handling:
    """An object changes hands, or is picked up or put down, within a task.

    Attributes:
        object: its name.
        waypoint: index into the task's path (0 = the configuration the task starts from) at
            which it happens.
        holder: robot that holds it from then on, None when it is put down, or comes up: the
            next brick of a feeding station is there once the one before it has been picked.
        pose: of the object's centre in the holder's flange frame, or in the world.
    """

    object: str
    waypoint: int
    holder: str | None
    pose: Transform


@dataclass(frozen=True)
class Task:
    """A piece of work of one robot: a transit to a goal, or a skill.

    Attributes:
        index: position in the sequential plan; the task's identity everywhere.
        robot: who does it.
        kind: ``"transit"`` or a name from SKILLS.
        step: assembly step it serves, counted from 1.
        label: short text for people, such as ``"pick b2_4"``.
        path: joint waypoints after the start, shape (w, n): the goal alone for a transit, the
            subgoals of the reference path for a skill.
        handlings: what changes hands in it, in order; ``waypoint`` counts within [start, *path].
        object: object it is about, None for a plain move.
        goal: whether its end is what the robot is to reach, so that no shortcut may pass by it.
    """

    index: int
    robot: str
    kind: str
    step: int
    label: str
    path: Array
    handlings: tuple[Handling, ...] = ()
    object: str | None = None
    goal: bool = False


@dataclass(frozen=True)
class AllowedContact:
    """Two things that may touch while the tasks listed are under way.

    Attributes:
        first, second: ``"<robot>/tool"``, an object's name or a fixture's name, unordered.
        tasks: indices of the tasks. A contact of a node of task m with something that is not a
            robot's node needs m in ``tasks``; a contact between nodes of tasks m and m' of two
            robots needs both.
    """

    first: str
    second: str
    tasks: frozenset[int]


def task_node(index: int) -> tuple[str, int]:
    """Return the node of a task in the task graph."""
    return ("task", index)


def object_node(name: str, occurrence: int) -> tuple[str, str, int]:
    """Return the node of an object at rest or offered: 0 at the start, 1 once put down..."""
    return ("object", name, occurrence)


def build_task_graph(
    tasks: Sequence[Task],
    dependencies: Iterable[tuple[int, int]] | Indices,
    *,
    later: Collection[str] = (),
) -> nx.DiGraph[Any]:
    """Build the task graph of APEX-MR IV-A.

    Task nodes carry ``task``, object nodes ``pose`` (world, or in the flange of the robot it is
    handed to). Edges carry ``kind``: ``"order"`` between consecutive tasks of a robot,
    ``"dependency"`` between tasks, ``"attached"`` from an object to the task that begins with
    it in hand, ``"detached"`` from a task to the object it leaves or lets come up.

    Args:
        tasks: of the sequential plan, indices in rising order.
        dependencies: pairs (a, b) of task indices: a must be complete before b starts.
        later: objects that are not there at the start, see ``CellObject.later``.

    Raises:
        PlanInvariantError: a dependency names no task, an object is handled by a robot that
            does not have it, or the graph has a cycle, which the message names.
    """
    graph: nx.DiGraph[Any] = nx.DiGraph()
    of_robot: dict[str, list[Task]] = defaultdict(list)
    for task in tasks:
        graph.add_node(task_node(task.index), task=task)
        before = of_robot[task.robot]
        if before:
            graph.add_edge(
                task_node(before[-1].index), task_node(task.index), kind="order"
            )
        before.append(task)
    for first, second in dependencies:
        for index in (first, second):
            if task_node(int(index)) not in graph:
                raise PlanInvariantError(
                    f"dependency ({first}, {second}) names task {index}, which is not there"
                )
        graph.add_edge(task_node(int(first)), task_node(int(second)), kind="dependency")
    _add_objects(graph, tasks, of_robot, later)
    if not nx.is_directed_acyclic_graph(graph):
        cycle = " -> ".join(
            _label(graph, edge[0]) for edge in nx.find_cycle(graph, orientation=None)
        )
        raise PlanInvariantError(f"the task graph has a cycle: {cycle}")
    return graph


def _add_objects(
    graph: nx.DiGraph[Any],
    tasks: Sequence[Task],
    of_robot: dict[str, list[Task]],
    later: Collection[str],
) -> None:
    """Add a node for every place where an object rests, with its edges."""
    occurrence: dict[str, int] = defaultdict(int)
    holder: dict[str, str | None] = {}
    for task in tasks:
        for handling in task.handlings:
            name = handling.object
            node = object_node(name, occurrence[name])
            held_by = holder.get(name)
            if held_by not in (None, task.robot):
                raise PlanInvariantError(
                    f"task {task.index} ({task.label}) handles {name}, which {held_by} holds"
                )
            if held_by is None and name in later and name not in holder:
                graph.add_node(node, pose=handling.pose)
                graph.add_edge(task_node(task.index), node, kind="detached")
            elif held_by is None:
                if handling.holder is None:
                    raise PlanInvariantError(
                        f"task {task.index} ({task.label}) puts down {name}, which nobody holds"
                    )
                graph.add_edge(node, task_node(task.index), kind="attached")
            if held_by is not None:
                occurrence[name] += 1
                node = object_node(name, occurrence[name])
                graph.add_node(node, pose=handling.pose)
                graph.add_edge(task_node(task.index), node, kind="detached")
                taker = _next_task(of_robot, handling.holder, task.index)
                if taker is not None:
                    graph.add_edge(node, task_node(taker.index), kind="attached")
            holder[name] = handling.holder


def _next_task(
    of_robot: dict[str, list[Task]], robot: str | None, index: int
) -> Task | None:
    """Return the first task of a robot after a given index."""
    if robot is None:
        return None
    return next((t for t in of_robot[robot] if t.index > index), None)


def _label(graph: nx.DiGraph[Any], node: tuple[object, ...]) -> str:
    """Return a node in words."""
    if node[0] == "object":
        return str(node[1])
    task = graph.nodes[node]["task"]
    return f"{task.index} ({task.robot}: {task.label})"
