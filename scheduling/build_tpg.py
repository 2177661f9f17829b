"""Build the temporal plan graph of a motion plan (APEX-MR IV-C, Algorithm 1)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from planning.motion.motion_plan import MotionPlan
from scheduling.build_nodes import build_nodes
from scheduling.conflicts.conflict_search import find_motion_edges
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.graph.reduction import order_and_reduce
from scheduling.graph.task_edges import dependency_edges
from scheduling.graph.temporal_plan_graph import (
    MOTION_CONFLICT,
    TASK_DEPENDENCY,
    TemporalPlanGraph,
)
from scheduling.invariant import check_invariant


def build_tpg(
    plan: MotionPlan, *, progress: Callable[[int, int], None] | None = None
) -> TemporalPlanGraph:
    """Return the temporal plan graph of a motion plan, reduced and checked.

    Args:
        plan: sequential or not; its planned times decide who goes first where.
        progress: called as the conflict search goes on, see ``find_motion_edges``.

    Raises:
        PlanInvariantError: the plan is not consistent, or a robot or object that stands is in
            the way of a motion planned meanwhile.
    """
    return connect_nodes(DerivedTpg(build_nodes(plan)), progress=progress)


def connect_nodes(
    nodes: DerivedTpg, *, progress: Callable[[int, int], None] | None = None
) -> TemporalPlanGraph:
    """Return the graph of nodes that have planned times, reduced and checked.

    Args:
        nodes: a graph whose edges are not looked at.
        progress: called as the conflict search goes on, see ``find_motion_edges``.

    Raises:
        PlanInvariantError: a robot or object that stands is in the way of a motion planned
            meanwhile.
    """
    task_edges = dependency_edges(nodes.tpg)
    implied, _ = order_and_reduce(nodes.ranks, task_edges)
    motion_edges = find_motion_edges(
        nodes.occupancies,
        nodes.ranks,
        implied,
        nodes.table,
        progress,
    )
    causes = np.array([TASK_DEPENDENCY, MOTION_CONFLICT], dtype=np.uint8)
    graph = nodes.with_edges(
        np.concatenate([task_edges, motion_edges]),
        np.repeat(causes, [len(task_edges), len(motion_edges)]),
    )
    check_invariant(graph, searched=True)
    return graph.tpg
