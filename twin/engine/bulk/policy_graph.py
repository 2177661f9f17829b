"""Precedence graph of a plan under an execution policy, as flat arrays for compiled passes.

Every policy releases nodes by what is complete, never by durations; so each of them is a graph.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from planning.transforms import Indices
from scheduling.graph.barriers import with_barriers
from scheduling.graph.machine_chains import machine_chains
from scheduling.graph.rollout import earliest_times
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.graph.total_order import flatten, planned_ranks
from scheduling.graph.turn_order import sequential_order
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
            nodes of robots, beside which machines go on; under ``"open-loop"`` a node waits for its planned time and nothing else.

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
    """Return one chain of all nodes of robots, in the order in which they take their turns.

    Machines take no turns: what waits for them, and they for others, is as in the plan.
    """
    order = _sequential_order(tpg)
    plain = precedence_arrays(tpg)
    of_machine = np.isin(plain.chain, list(machine_chains(tpg)))
    turns = order[~of_machine[order]]
    pairs = np.stack([turns[:-1], turns[1:]], axis=1)
    pairs = pairs[plain.chain[pairs[:, 0]] != plain.chain[pairs[:, 1]]]
    target = np.repeat(np.arange(len(order)), np.diff(plain.edge_first))
    kept = of_machine[plain.source] | of_machine[target]
    source = np.concatenate([plain.source[kept], pairs[:, 0]])
    target = np.concatenate([target[kept], pairs[:, 1]])
    other = np.full(len(pairs), OTHER, dtype=np.uint8)
    cause = np.concatenate([plain.cause[kept], other])
    row = np.argsort(target, kind="stable")
    into = np.bincount(target, minlength=len(order))
    return plain._replace(
        order=order,
        edge_first=np.concatenate([[0], np.cumsum(into)]).astype(np.int64),
        source=source[row],
        cause=cause[row],
    )


def _sequential_order(tpg: TemporalPlanGraph) -> Indices:
    return np.fromiter(sequential_order(tpg), dtype=np.int64)
