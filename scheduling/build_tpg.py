"""Build the temporal plan graph of a motion plan (APEX-MR IV-C, Algorithm 1)."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import count, permutations

import numpy as np

from planning.motion.motion_plan import MotionPlan
from planning.parallel import map_in_parallel
from planning.progress import Progress, no_progress
from planning.transforms import Indices
from scheduling.build_nodes import build_nodes
from scheduling.conflicts.conflict_search import search_conflicts
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.graph.task_edges import dependency_edges
from scheduling.graph.temporal_plan_graph import (
    MOTION_CONFLICT,
    NO_EDGES,
    TASK_DEPENDENCY,
    Causes,
    TemporalPlanGraph,
)
from scheduling.graph.total_order import nodes_before, transitive_reduction
from scheduling.invariant import check_invariant


def build_tpg(
    plan: MotionPlan, *, progress: Progress = no_progress
) -> TemporalPlanGraph:
    """Return the temporal plan graph of a motion plan, reduced and checked.

    Args:
        plan: sequential or not; its planned times decide the precedence of conflicting nodes.
        progress: called during the conflict search, see ``find_motion_edges``.

    Raises:
        PlanInvariantError: the plan is not consistent, or a robot or object that stands is in
            the way of a motion planned meanwhile.
    """
    return connect_nodes(DerivedTpg(build_nodes(plan)), progress=progress)


def connect_nodes(
    nodes: DerivedTpg,
    known: tuple[Indices, Causes] = NO_EDGES,
    searched: Sequence[int] = (),
    earlier: Sequence[int] = (),
    *,
    progress: Progress = no_progress,
) -> TemporalPlanGraph:
    """Return the graph of nodes with planned times, reduced and checked.

    Args:
        nodes: a graph whose edges are ignored.
        known: edges in addition to those of dependencies, shape (e, 4), and their causes: what they
            imply is not searched again.
        searched: number of first nodes of each chain, by default none. Conflicts among these are ordered by ``known``.
        earlier: number of first nodes of each chain that precede the others, as many as ``searched`` or more: conflicts
            among the others are ordered by ``known``. By default those searched.
        progress: called during the conflict search, see ``find_motion_edges``.

    Raises:
        PlanInvariantError: a robot or object that stands is in the way of a motion planned
            meanwhile.
    """
    task_edges = dependency_edges(nodes.tpg)
    settled = np.concatenate([task_edges, known[0]])
    motion_edges = find_motion_edges(nodes, settled, progress, searched, earlier)
    causes = [
        np.full(len(task_edges), TASK_DEPENDENCY, dtype=np.uint8),
        known[1],
        np.full(len(motion_edges), MOTION_CONFLICT, dtype=np.uint8),
    ]
    graph = nodes.with_edges(
        np.concatenate([settled, motion_edges]), np.concatenate(causes)
    )
    # What precedes what is computed again, from the edges that are left.
    same = ("ranks", "history", "spans", "occupancies")
    check_invariant(graph.derive(graph.tpg, *same), searched=True, before=searched)
    return graph.tpg


def find_motion_edges(
    nodes: DerivedTpg,
    task_edges: Indices,
    progress: Progress = no_progress,
    searched: Sequence[int] = (),
    earlier: Sequence[int] = (),
) -> Indices:
    """Return the type-2 edges that motion conflicts require, not reduced, shape (e, 4).

    For each ordered pair of robots and each node v of the one, the last node u of the other that
    is earlier in the total order and conflicts with v must be complete before v starts.
    Occupancies are swept, from the configuration before a node to its own, so the edge starts at
    that last conflicting node itself: once it is complete its robot stands at the start of the
    next node, which is clear of v. With the paper's point occupancies that is its successor rule.

    Args:
        nodes: a graph whose edges are ignored.
        task_edges: what is known to precede; not searched again.
        progress: called after each ordered pair of robots with pairs done and in all, by the
            thread that searched it.
        searched, earlier: see ``connect_nodes``.
    """
    implied, _ = transitive_reduction(nodes.ranks, task_edges)
    earlier = earlier or searched
    occupancies = nodes.occupancies
    todo = list(permutations(range(len(occupancies)), 2))
    done = count(1)

    def search(pair: tuple[int, int]) -> list[tuple[int, int, int, int]]:
        i, k = pair
        floor = implied.last_before(i, k).copy()
        limit = nodes_before(nodes.ranks, i, k)
        if searched:
            first = searched[i]
            limit[:first] = np.minimum(limit[:first], floor[:first] + 1)
            limit[first:] = np.minimum(limit[first:], earlier[k])
        own, other = occupancies[i], occupancies[k]
        found = search_conflicts(own, other, floor, limit, nodes.table)
        edges = [(k, u, i, v) for v, u in found]
        progress(next(done), len(todo))
        return edges

    edges = {edge for found in map_in_parallel(search, todo) for edge in found}
    return np.array(sorted(edges), dtype=np.int64).reshape(-1, 4)
