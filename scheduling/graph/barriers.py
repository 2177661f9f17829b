"""Synchronization barriers between the slots of a synchronous plan, as edges of a graph (APEX-MR, section V-A).

In a slot every robot does at most one task. A slot begins when the one before it is complete.
"""

from __future__ import annotations

import numpy as np

from planning.errors import PlanInvariantError
from planning.transforms import Indices
from scheduling.graph.task_edges import add_edges
from scheduling.graph.temporal_plan_graph import (
    NO_EDGES,
    TASK_DEPENDENCY,
    TemporalPlanGraph,
)


def with_barriers(
    tpg: TemporalPlanGraph, cause: int = TASK_DEPENDENCY
) -> TemporalPlanGraph:
    """Return the graph with barriers between its slots, see ``barrier_edges``.

    Args:
        tpg: of a plan made in slots.
        cause: of the waits that are added.

    Raises:
        PlanInvariantError: the plan was not made in slots, or a robot goes back to an earlier
            slot.
    """
    return add_edges(tpg, [barrier_edges(tpg)], cause)


def barrier_edges(tpg: TemporalPlanGraph) -> Indices:
    """Return the edges by which no robot enters a slot before all have left the earlier ones.

    Every node that is the first of its robot in a slot waits for the last node of each other
    robot in any earlier slot.

    Args:
        tpg: of a plan made in slots.

    Raises:
        PlanInvariantError: the plan was not made in slots, or a robot goes back to an earlier
            slot.
    """
    if len(tpg.slots) != len(tpg.tasks):
        raise PlanInvariantError(
            "this plan was not made in slots, so robots have nothing to wait for together"
        )
    slot_of = np.full(max((t.index for t in tpg.tasks), default=0) + 1, -1)
    slot_of[[task.index for task in tpg.tasks]] = tpg.slots
    slots = [slot_of[chain.task] for chain in tpg.chains]
    for chain, own in zip(tpg.chains, slots, strict=True):
        if np.any(np.diff(own) < 0):
            raise PlanInvariantError(f"robot {chain.robot!r} goes back to a slot")
    edges = [NO_EDGES[0]]
    for k, own in enumerate(slots):
        entries = np.flatnonzero(np.diff(own, prepend=-1) > 0)
        for i, other in enumerate(slots):
            if i == k:
                continue
            last = np.searchsorted(other, own[entries]) - 1
            new = last >= 0
            rows = np.empty((np.count_nonzero(new), 4), dtype=np.int64)
            rows[:, 0], rows[:, 1] = i, last[new]
            rows[:, 2], rows[:, 3] = k, entries[new]
            edges.append(rows)
    return np.concatenate(edges)
