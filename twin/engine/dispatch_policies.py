"""Dispatch policies: rules for when the dispatcher releases a node (a piece of planned motion) to its robot.

The engines release a node when all its predecessors in the graph are complete. A policy adds edges to the graph of the
plan. Engines, forecasts and exports treat these like other edges. Two built-in policies are implemented in the engines
instead: the open-loop policy, in which robots follow the planned times, and the sequential policy, in which one robot
works at a time while machines work in parallel.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from planning.errors import RequestError
from planning.transforms import Indices
from scheduling.graph.task_edges import add_edges, sequential_order
from scheduling.graph.temporal_plan_graph import (
    NO_EDGES,
    TASK_DEPENDENCY,
    TemporalPlanGraph,
)
from twin.registry import POLICIES


class DispatchPolicy(Protocol):
    """Function that adds edges to the graph of a plan, so that nodes wait for further nodes."""

    def __call__(self, tpg: TemporalPlanGraph, /) -> Indices:
        """Return further edges of a graph, shape (e, 4).

        Each row is the chain and node that must be complete, and the chain and node that waits for it.

        Args:
            tpg: the plan; studies give it without paths.
        """
        ...


def no_edges(_tpg: TemporalPlanGraph) -> Indices:
    """Return no edges: nodes wait as planned."""
    return NO_EDGES[0]


def with_policy(
    tpg: TemporalPlanGraph, policy: str, cause: int = TASK_DEPENDENCY
) -> TemporalPlanGraph:
    """Return the graph with the edges of a policy.

    Args:
        tpg: the plan, without edges that hold for some time only.
        policy: its name.
        cause: of the waits that are added.

    Raises:
        PlanInvariantError: the policy is synchronous, but the plan was not made in slots.
        RequestError: a registered policy returned what are no edges, or edges in a circle.
    """
    make_edges: DispatchPolicy = POLICIES.load(policy)
    edges = np.asarray(make_edges(tpg))
    if policy not in POLICIES.own:
        _require_edges(tpg, policy, edges)
    if not len(edges):
        return tpg
    found = add_edges(tpg, [edges], cause)
    if policy not in POLICIES.own:
        nodes = sum(map(len, found.chains))
        if sum(1 for _ in sequential_order(found)) < nodes:
            raise RequestError(
                f"policy {policy!r}: nodes wait for each other in a circle"
            )
    return found


def _require_edges(tpg: TemporalPlanGraph, policy: str, edges: Indices) -> None:
    if edges.size and (edges.dtype.kind != "i" or edges.shape[1:] != (4,)):
        raise RequestError(
            f"policy {policy!r}: edges must be integers of shape (e, 4), not {edges.dtype} of shape {edges.shape}"
        )
    lengths = [len(chain) for chain in tpg.chains]
    for edge in edges.tolist():
        for chain, node in (edge[:2], edge[2:]):
            if not (0 <= chain < len(lengths) and 0 <= node < lengths[chain]):
                raise RequestError(
                    f"policy {policy!r}: there is no node {node} of chain {chain}"
                )
