"""Edges of a graph for a given task order, from cached conflicts and dependencies between pairs of tasks."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from planning.transforms import Indices
from scheduling.build_tpg import connect_nodes
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.graph.task_edges import dependency_edges
from scheduling.graph.temporal_plan_graph import (
    MOTION_CONFLICT,
    TASK_DEPENDENCY,
    NodeChain,
    TemporalPlanGraph,
)
from scheduling.ordering.relations import TaskRelations


def connect_in_order(
    chains: Sequence[NodeChain],
    relations: TaskRelations,
    order: Sequence[tuple[int, ...]],
) -> TemporalPlanGraph:
    """Return the graph that ``connect_nodes`` would make of some chains, without a check of its invariant.

    Args:
        chains: with planned starts in that order, see ``put_in_order``.
        relations: of their units.
        order: blocks of units, one after another.

    Raises:
        PlanInvariantError: units that move simultaneously conflict.
    """
    tpg = replace(relations.graph.tpg, chains=tuple(chains))
    if any(len(block) > 1 for block in order):
        return connect_nodes(DerivedTpg(tpg))
    tasks = dependency_edges(tpg)
    motions = _motion_edges(relations, tasks, [block[0] for block in order])
    causes = np.array([TASK_DEPENDENCY, MOTION_CONFLICT], dtype=np.uint8)
    edges = np.concatenate([tasks, motions])
    cause = np.repeat(causes, [len(tasks), len(motions)])
    return DerivedTpg(tpg).with_edges(edges, cause).tpg


def _motion_edges(
    relations: TaskRelations, tasks: Indices, order: Sequence[int]
) -> Indices:
    """Return edges for the conflicts between units, except those that task dependencies imply already."""
    units, chains = relations.units, range(len(relations.of_chain))
    needs: dict[int, list[int]] = defaultdict(list)
    for i, u, k, v in tasks.tolist():
        needs[relations.unit_of((k, v))].append(relations.unit_of((i, u)))
    edges: list[tuple[int, int, int, int]] = []
    # How many units of each chain are known to be complete before each unit starts.
    complete: dict[int, list[int]] = {}
    done = [0 for _ in chains]
    last: dict[int, int] = {}

    def follow(known: list[int], unit: int) -> None:
        for chain, count in enumerate(complete[unit]):
            known[chain] = max(known[chain], count)
        chain, place = units[unit].chain, units[unit].place
        known[chain] = max(known[chain], place + 1)

    for unit in order:
        own, known = units[unit], [0 for _ in chains]
        for earlier in [
            *needs[unit],
            *([last[own.chain]] if own.chain in last else []),
        ]:
            follow(known, earlier)
        for chain in chains:
            if chain == own.chain:
                continue
            for place in range(done[chain] - 1, -1, -1):
                if place < known[chain]:
                    break
                other = relations.of_chain[chain][place]
                stairs = relations.stairs(other, unit)
                if stairs is None:
                    continue
                u = units[other]
                nodes, after = stairs
                edges += [
                    (chain, u.first + a, own.chain, own.first + b)
                    for b, a in zip(nodes.tolist(), after.tolist(), strict=True)
                ]
                if nodes[0] == 0 and u.first + after[0] == u.stop - 1:
                    follow(known, other)
        complete[unit], last[own.chain] = known, unit
        done[own.chain] += 1
    return np.array(edges, dtype=np.int64).reshape(-1, 4)
