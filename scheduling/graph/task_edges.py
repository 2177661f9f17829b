"""Nodes of each task, and the edges between nodes of different robots that task dependencies require."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from graphlib import CycleError, TopologicalSorter
from heapq import heapify, heappop, heappush

import numpy as np

from planning.errors import PlanInvariantError
from planning.tasks.task_graph import TaskGraph, task_graph
from planning.transforms import Indices
from scheduling.graph.dispatcher import Dispatcher
from scheduling.graph.temporal_plan_graph import (
    NodeChain,
    TemporalPlanGraph,
)


@dataclass(frozen=True)
class TaskNodes:
    """The nodes of a task.

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
        tpg: its nodes, tasks and dependencies; its edges are ignored.

    Raises:
        PlanInvariantError: a dependency goes against the plan's own order within a robot, or
            names a task that is not there.
    """
    nodes = {own.task: own for chain in task_nodes(tpg.chains) for own in chain}
    graph = task_graph(tpg.tasks, tpg.dependencies)
    ends = _last_nodes(graph, nodes)
    edges: set[tuple[int, int, int, int]] = set()
    for b in graph:
        if b not in nodes:
            continue
        target = nodes[b]
        for a in graph.predecessors(b):
            if "task" not in graph.nodes[a]:
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


def _last_nodes(
    graph: TaskGraph, nodes: dict[int, TaskNodes]
) -> dict[int, frozenset[tuple[int, int]]]:
    """Return, by task, the nodes (chain, node) at whose completion it is complete."""
    ends = {task: frozenset([(own.chain, own.stop - 1)]) for task, own in nodes.items()}
    empty = {
        task: list(graph.predecessors(task)) for task in graph if task not in nodes
    }
    try:
        for task in TopologicalSorter(empty).static_order():
            if task in empty:
                ends[task] = frozenset().union(*(ends[s] for s in empty[task]))
    except CycleError as error:
        raise PlanInvariantError(f"task {error.args[1][0]} depends on itself") from None
    return ends


def add_edges(
    tpg: TemporalPlanGraph, edges: Sequence[Indices], cause: int
) -> TemporalPlanGraph:
    """Return the graph with further edges, without duplicates, its own ones first."""
    every = np.concatenate([tpg.edges, *edges])
    unique, first = np.unique(every, axis=0, return_index=True)
    causes = np.full(len(every), cause, dtype=np.uint8)
    causes[: len(tpg.edges)] = tpg.cause
    return replace(tpg, edges=unique, cause=causes[first])


def sequential_order(tpg: TemporalPlanGraph) -> Iterator[int]:
    """Yield node numbers, counted chain by chain from 0, in the order of the sequential policy.

    Of the nodes that are safe, that of the earliest task comes first. Machines do what they can at
    once: robots take their turns in the same order however long they wait for them.
    """
    machines = tpg.machine_chains()
    first = np.cumsum([0, *(len(chain) for chain in tpg.chains)]).tolist()
    dispatcher = Dispatcher(tpg)
    task = [
        [-1] * len(chain) if k in machines else chain.task.tolist()
        for k, chain in enumerate(tpg.chains)
    ]
    ready = [(task[k][node], k, node) for k, node in dispatcher.ready()]
    heapify(ready)
    while ready:
        _, chain, node = heappop(ready)
        yield first[chain] + node
        for k, safe in dispatcher.complete(chain, node):
            heappush(ready, (task[k][safe], k, safe))


def turn_edges(tpg: TemporalPlanGraph) -> Indices:
    """Return the edges that make robots wait for their turn, in the order of the sequential policy."""
    first = np.cumsum([0, *(len(chain) for chain in tpg.chains)])
    order = np.fromiter(sequential_order(tpg), dtype=np.int64)
    chain = np.searchsorted(first, order, side="right") - 1
    robots = ~np.isin(chain, list(tpg.machine_chains()))
    chain, node = chain[robots], (order - first[chain])[robots]
    rows = np.stack([chain[:-1], node[:-1], chain[1:], node[1:]], axis=1)
    return np.asarray(rows[rows[:, 0] != rows[:, 2]])


def turn_order(tpg: TemporalPlanGraph) -> list[int]:
    """Return the chains of robots in the order in which their nodes take turns.

    It is fixed beforehand: what a machine takes for its tasks must not change it.
    """
    machines = tpg.machine_chains()
    first = np.cumsum([0, *(len(chain) for chain in tpg.chains)])
    order = np.fromiter(sequential_order(tpg), dtype=np.int64)
    chains = np.searchsorted(first, order, side="right") - 1
    return [k for k in chains.tolist() if k not in machines]
