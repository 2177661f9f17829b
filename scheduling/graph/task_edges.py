"""The nodes of each task, and the type-2 edges that task dependencies ask for."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter

import numpy as np

from planning.errors import PlanInvariantError
from planning.transforms import Indices
from scheduling.graph.temporal_plan_graph import NodeChain, TemporalPlanGraph


@dataclass(frozen=True)
class TaskNodes:
    """The nodes of a task that has any.

    Attributes:
        task: its index.
        chain: index of its robot's chain.
        first, stop: its nodes are ``range(first, stop)``.
        place: how many tasks with nodes its robot has before it.
    """

    task: int
    chain: int
    first: int
    stop: int
    place: int


def task_nodes(chains: Sequence[NodeChain]) -> list[list[TaskNodes]]:
    """Return the tasks of each chain that have nodes, in order."""
    out = []
    for index, chain in enumerate(chains):
        tasks, first = np.unique(chain.task, return_index=True)
        bounds = [*first.tolist(), len(chain)]
        out.append(
            [
                TaskNodes(task, index, bounds[k], bounds[k + 1], k)
                for k, task in enumerate(tasks.tolist())
            ]
        )
    return out


def dependency_edges(tpg: TemporalPlanGraph) -> Indices:
    """Return a type-2 edge for every task dependency between robots, shape (e, 4).

    From the last node of the task that must be complete to the first node of the task that
    then may start. A task without nodes passes on what it waits for.

    Args:
        tpg: its nodes, tasks and dependencies; its edges are not looked at.

    Raises:
        PlanInvariantError: a dependency goes against the plan's own order within a robot, or
            names a task that is not there.
    """
    nodes = {own.task: own for chain in task_nodes(tpg.chains) for own in chain}
    before = _prerequisites(tpg)
    ends = _last_nodes(before, nodes)
    known = {task.index for task in tpg.tasks}
    edges: set[tuple[int, int, int, int]] = set()
    for b, sources in before.items():
        if b not in nodes:
            continue
        target = nodes[b]
        for a in sources:
            if a not in known:
                raise PlanInvariantError(
                    f"task {b} depends on task {a}, which is not there"
                )
            for chain, node in ends[a]:
                if chain != target.chain:
                    edges.add((chain, node, target.chain, target.first))
                elif node >= target.first:
                    raise PlanInvariantError(
                        f"task {b} depends on task {a}, which robot"
                        f" {tpg.chains[chain].robot!r} does after it"
                    )
    return np.array(sorted(edges), dtype=np.int64).reshape(-1, 4)


def _prerequisites(tpg: TemporalPlanGraph) -> dict[int, list[int]]:
    """Return the tasks before each task: its dependencies, and its robot's task before it."""
    before: dict[int, list[int]] = defaultdict(list)
    for a, b in tpg.dependencies.tolist():
        before[b].append(a)
    previous: dict[str, int] = {}
    for task in tpg.tasks:
        if task.robot in previous:
            before[task.index].append(previous[task.robot])
        previous[task.robot] = task.index
    return before


def _last_nodes(
    before: dict[int, list[int]], nodes: dict[int, TaskNodes]
) -> dict[int, frozenset[tuple[int, int]]]:
    """Return, by task, the nodes (chain, node) whose completion says that it is complete."""
    ends = {task: frozenset([(own.chain, own.stop - 1)]) for task, own in nodes.items()}
    mentioned = {task for a, sources in before.items() for task in (a, *sources)}
    empty = {task: before.get(task, []) for task in mentioned - nodes.keys()}
    try:
        for task in TopologicalSorter(empty).static_order():
            if task in empty:
                ends[task] = frozenset().union(*(ends[s] for s in empty[task]))
    except CycleError as error:
        raise PlanInvariantError(f"task {error.args[1][0]} depends on itself") from None
    return ends
