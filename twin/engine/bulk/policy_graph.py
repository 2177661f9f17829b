"""Precedence graph of a plan under an execution policy, as flat arrays for compiled passes.

Every policy releases nodes by what is complete, never by durations; so each of them is a graph.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from heapq import heapify, heappop, heappush
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from planning.transforms import Indices
from scheduling.graph.barriers import with_barriers
from scheduling.graph.dispatcher import Dispatcher
from scheduling.graph.rollout import earliest_times
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.graph.total_order import flatten, planned_ranks
from twin.durations import Nanoseconds
from twin.run.run_record import Policy
from twin.uncertainty.skill_durations import nominal_ns

OTHER = 2
"""Cause of a wait that the plan did not ask for: a message under way, the clock, a turn."""


class PrecedenceArrays(NamedTuple):
    """A flat graph with the causes of its edges and earliest starts.

    Attributes:
        first, chain, order, edge_first, source: see FlatGraph.
        cause: why, by edge, shape (edges,).
        not_before: no node starts before this, shape (nodes,) [ns].
    """

    first: Indices
    chain: Indices
    order: Indices
    edge_first: Indices
    source: Indices
    cause: npt.NDArray[np.uint8]
    not_before: Nanoseconds


def policy_graph(tpg: TemporalPlanGraph, policy: Policy) -> PrecedenceArrays:
    """Return what every node of a plan waits for under a policy.

    Args:
        tpg: the plan.
        policy: ``"asynchronous"`` waits by the edges of the plan, ``"synchronous"`` for
            everyone at the end of each slot as well; ``"sequential"`` is one chain of all
            nodes; under ``"open-loop"`` a node waits for its planned time and nothing else.

    Raises:
        PlanInvariantError: the policy is synchronous, but the plan was not made in slots.
    """
    if policy == "synchronous":
        barred = with_barriers(tpg, cause=OTHER)
        # Barriers need not follow the planned starts, as edges do.
        return precedence_arrays(barred)._replace(order=_sequential_order(barred))
    if policy == "sequential":
        return _in_turns(tpg)
    if policy == "open-loop":
        none = np.empty((0, 4), dtype=np.int64)
        free = replace(tpg, edges=none, cause=np.empty(0, dtype=np.uint8))
        starts = earliest_times(tpg, nominal_ns(tpg)).start
        return precedence_arrays(free, np.concatenate(starts))
    return precedence_arrays(tpg)


def precedence_arrays(
    tpg: TemporalPlanGraph, not_before_ns: Nanoseconds | None = None
) -> PrecedenceArrays:
    """Return what every node of a TPG, contracted or not, waits for.

    Args:
        tpg: the graph.
        not_before_ns: no node starts before this, shape (nodes,) [ns]; 0 by default.
    """
    flat = flatten(planned_ranks(tpg.chains), tpg.edges)
    return PrecedenceArrays(
        flat.first,
        flat.chain,
        flat.order,
        flat.edge_first,
        flat.source,
        tpg.cause[flat.row],
        np.zeros_like(flat.order) if not_before_ns is None else not_before_ns,
    )


def _in_turns(tpg: TemporalPlanGraph) -> PrecedenceArrays:
    """Return one chain of all nodes, in the order in which they take their turns."""
    order = _sequential_order(tpg)
    plain = precedence_arrays(tpg)
    source = np.full(len(order), -1, dtype=np.int64)
    source[order[1:]] = order[:-1]
    has_edge = (source >= 0) & (plain.chain[source] != plain.chain)
    return plain._replace(
        order=order,
        edge_first=np.concatenate([[0], np.cumsum(has_edge)]).astype(np.int64),
        source=source[has_edge],
        cause=np.full(np.count_nonzero(has_edge), OTHER, dtype=np.uint8),
    )


def _sequential_order(tpg: TemporalPlanGraph) -> Indices:
    return np.fromiter(sequential_order(tpg), dtype=np.int64)


def sequential_order(tpg: TemporalPlanGraph) -> Iterator[int]:
    """Yield node numbers, chain by chain from 0, in the order of the sequential policy.

    Of the nodes that are safe, that of the earliest task comes first.
    """
    first = np.cumsum([0, *(len(chain) for chain in tpg.chains)]).tolist()
    dispatcher = Dispatcher(tpg)
    task = [chain.task.tolist() for chain in tpg.chains]
    ready = [(task[k][node], k, node) for k, node in dispatcher.ready()]
    heapify(ready)
    while ready:
        _, chain, node = heappop(ready)
        yield first[chain] + node
        for k, safe in dispatcher.complete(chain, node):
            heappush(ready, (task[k][safe], k, safe))
