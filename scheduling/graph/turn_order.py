"""The order of nodes where one robot works at a time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from heapq import heapify, heappop, heappush

import numpy as np

from scheduling.graph.dispatcher import Dispatcher
from scheduling.graph.machine_chains import machine_chains
from scheduling.graph.temporal_plan_graph import TASK_DEPENDENCY, TemporalPlanGraph


def sequential_order(tpg: TemporalPlanGraph) -> Iterator[int]:
    """Yield node numbers, chain by chain from 0, in the order of the sequential policy.

    Of the nodes that are safe, that of the earliest task comes first. Machines do what they can at
    once: robots take their turns in the same order however long they wait for them.
    """
    machines = machine_chains(tpg)
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


def with_turns(tpg: TemporalPlanGraph) -> TemporalPlanGraph:
    """Return the graph in which robots take their turns by edges of their own.

    So a robot knows how far it may go before it is another one's turn.
    """
    first = np.cumsum([0, *(len(chain) for chain in tpg.chains)])
    order = np.fromiter(sequential_order(tpg), dtype=np.int64)
    chain = np.searchsorted(first, order, side="right") - 1
    robots = ~np.isin(chain, list(machine_chains(tpg)))
    chain, node = chain[robots], (order - first[chain])[robots]
    rows = np.stack([chain[:-1], node[:-1], chain[1:], node[1:]], axis=1)
    rows = rows[rows[:, 0] != rows[:, 2]]
    edges = np.concatenate([tpg.edges, rows])
    unique, row = np.unique(edges, axis=0, return_index=True)
    cause = np.full(len(edges), TASK_DEPENDENCY, dtype=np.uint8)
    cause[: len(tpg.edges)] = tpg.cause
    return replace(tpg, edges=unique, cause=cause[row])
