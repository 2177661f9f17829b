"""Build the temporal plan graph of a motion plan (APEX-MR IV-C, Algorithm 1).

Nodes of a temporal plan graph, from the timed paths of a motion plan (APEX-MR IV-C).
"""

from __future__ import annotations

from itertools import count, pairwise, permutations

import numpy as np

from planning.errors import PlanInvariantError
from planning.motion.known_motions import MotionPlan, TaskMotion
from planning.parallel import side_by_side
from planning.progress import Progress, no_progress
from planning.tasks.task import TRANSIT, Task, still_borders
from planning.transforms import Array, Indices, readonly
from scheduling.conflicts.conflict_search import search_conflicts
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.graph.task_edges import dependency_edges
from scheduling.graph.temporal_plan_graph import (
    MOTION_CONFLICT,
    NO_EDGES,
    TASK_DEPENDENCY,
    Causes,
    NodeChain,
    NodeHandling,
    TemporalPlanGraph,
    join_chains,
)
from scheduling.graph.total_order import nodes_before, order_and_reduce
from scheduling.invariant import check_invariant

_SAME = 1e-9
"""Joint values that differ by less are the same configuration [rad or m]."""

_Where = dict[int, tuple[int, int]]
"""Node, counted from 0, and waypoint of it that each waypoint of a task's path became."""


def build_nodes(plan: MotionPlan) -> TemporalPlanGraph:
    """Return the graph of a plan without type-2 edges: safe only one task after another.

    Each waypoint of a transit but the first becomes a pose node, a skill one node. Pose nodes
    that do not move, waits of the input plan, are dropped (APEX-MR IV-C).

    Raises:
        PlanInvariantError: paths do not join, times fall, or arrays do not fit.
    """
    chains: list[NodeChain] = []
    handlings: list[tuple[float, NodeHandling]] = []
    for robot in (*plan.cell.robots, *plan.cell.machines):
        own = [
            (task, motion)
            for task, motion in zip(plan.tasks, plan.motions, strict=True)
            if task.robot == robot.name
        ]
        parts, given = _nodes_of_robot(own, len(chains))
        if any(len(part) for part in parts):
            handlings += given
            chains.append(join_chains(parts).frozen())
    handlings.sort(key=lambda item: item[0])
    return TemporalPlanGraph(
        plan.cell,
        plan.tasks,
        tuple(chains),
        *NO_EDGES,
        tuple(handling for _, handling in handlings),
        plan.allowed,
        np.asarray(plan.dependencies, dtype=np.int64).reshape(-1, 2),
        windows=plan.windows,
    )


def _nodes_of_robot(
    own: list[tuple[Task, TaskMotion]], chain: int
) -> tuple[list[NodeChain], list[tuple[float, NodeHandling]]]:
    """Return the nodes of each task of a robot, and what changes hands in them, and when [s]."""
    parts: list[NodeChain] = []
    handlings: list[tuple[float, NodeHandling]] = []
    last: Task | None = None
    end: Array | None = None
    first = 0
    for task, motion in own:
        path = np.array(motion.path, dtype=np.float64)
        time = np.asarray(motion.time, dtype=np.float64)
        _check_arrays(task, path, time)
        if end is not None and np.max(np.abs(path[0] - end)) > _SAME:
            raise PlanInvariantError(
                f"{_name(task)} starts {np.max(np.abs(path[0] - end)):.3g} away from where"
                f" task {'before it' if last is None else last.index} ended"
            )
        as_nodes = _poses if task.kind == TRANSIT else _skill
        nodes, where = as_nodes(task, path, time)
        for h in task.handlings:
            node, waypoint = where[h.waypoint]
            handling = NodeHandling(
                h.object, chain, first + node, waypoint, h.holder, readonly(h.pose)
            )
            handlings.append((float(time[h.waypoint]), handling))
        parts.append(nodes)
        last = task if len(nodes) else last
        first += len(nodes)
        end = path[-1]
    return parts, handlings


def _check_arrays(task: Task, path: Array, time: Array) -> None:
    if path.ndim != 2 or len(path) == 0 or time.shape != (len(path),):
        raise PlanInvariantError(
            f"{_name(task)}: {time.shape} times for a path of shape {path.shape}"
        )
    if np.any(np.diff(time) < 0.0):
        raise PlanInvariantError(f"{_name(task)}: its planned times fall")
    for handling in task.handlings:
        if not 0 <= handling.waypoint < len(path):
            raise PlanInvariantError(
                f"{_name(task)}: handles {handling.object!r} at waypoint"
                f" {handling.waypoint} of a path with {len(path)}"
            )


def _name(task: Task) -> str:
    return f"task {task.index} ({task.label}) of robot {task.robot!r}"


def _poses(task: Task, path: Array, time: Array) -> tuple[NodeChain, _Where]:
    """Return a node for every waypoint that the robot moves to or handles something at."""
    handled = {h.waypoint for h in task.handlings}
    keep = np.zeros(len(path), dtype=np.bool_)
    keep[1:] = np.any(path[1:] != path[:-1], axis=1)
    keep[list(handled - {0})] = True
    if 0 in handled:
        # What happens at the start happens as the first node starts.
        keep[min(1, len(path) - 1)] = True
    nodes = np.flatnonzero(keep)
    where = {k: (node, 1) for node, k in enumerate(nodes.tolist())}
    if keep[:2].any():
        where[0] = (0, 0)
    start = time[np.maximum(nodes - 1, 0)]
    fraction, first = np.ones(len(nodes)), np.arange(len(nodes) + 1)
    return _nodes(task, path, nodes, fraction, first, start, time[nodes]), where


def _skill(task: Task, path: Array, time: Array) -> tuple[NodeChain, _Where]:
    """Return a node for each motion of a skill, and for each stretch in which a tool closes or opens.

    What changes hands between two of them does so at the end of the first.
    """
    waypoints = np.arange(min(1, len(path) - 1), len(path))
    first = np.array(still_borders(task, len(waypoints)), dtype=np.int64)
    fraction = np.arange(1, len(waypoints) + 1, dtype=np.float64)
    where: _Where = {0: (0, 0)}
    for node, (low, high) in enumerate(pairwise(first.tolist())):
        own, span = slice(low, high), time[waypoints[high - 1]] - time[low]
        if len(path) > 1 and span > 0.0:
            fraction[own] = (time[low + 1 : high + 1] - time[low]) / span
        else:
            fraction[own] = np.arange(1, high - low + 1) / (high - low)
        fraction[high - 1] = 1.0
        where |= {low + k: (node, k) for k in range(1, high - low + 1)}
    start, end = time[first[:-1]], time[waypoints[first[1:] - 1]]
    return _nodes(task, path, waypoints, fraction, first, start, end), where


def _nodes(
    task: Task,
    path: Array,
    waypoints: Indices,
    fraction: Array,
    first: Indices,
    start: Array,
    end: Array,
) -> NodeChain:
    return NodeChain(
        task.robot,
        path[0],
        path[waypoints],
        fraction,
        first,
        np.full(len(start), task.index),
        np.full(len(start), task.kind != TRANSIT),
        end - start,
        start,
    )


def build_tpg(
    plan: MotionPlan, *, progress: Progress = no_progress
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
    nodes: DerivedTpg,
    known: tuple[Indices, Causes] = NO_EDGES,
    *,
    progress: Progress = no_progress,
) -> TemporalPlanGraph:
    """Return the graph of nodes that have planned times, reduced and checked.

    Args:
        nodes: a graph whose edges are not looked at.
        known: edges that hold beside those of dependencies, shape (e, 4), and their causes: what they
            imply is not searched again.
        progress: called as the conflict search goes on, see ``find_motion_edges``.

    Raises:
        PlanInvariantError: a robot or object that stands is in the way of a motion planned
            meanwhile.
    """
    task_edges = dependency_edges(nodes.tpg)
    settled = np.concatenate([task_edges, known[0]])
    motion_edges = find_motion_edges(nodes, settled, progress)
    causes = [
        np.full(len(task_edges), TASK_DEPENDENCY, dtype=np.uint8),
        known[1],
        np.full(len(motion_edges), MOTION_CONFLICT, dtype=np.uint8),
    ]
    graph = nodes.with_edges(
        np.concatenate([settled, motion_edges]), np.concatenate(causes)
    )
    # What precedes what is worked out anew, from the edges that are left.
    same = ("ranks", "history", "spans", "occupancies")
    check_invariant(graph.derive(graph.tpg, *same), searched=True)
    return graph.tpg


def find_motion_edges(
    nodes: DerivedTpg,
    task_edges: Indices,
    progress: Progress = no_progress,
) -> Indices:
    """Return the type-2 edges that motion conflicts ask for, not reduced, shape (e, 4).

    For each ordered pair of robots and each node v of the one, the last node u of the other that
    is earlier in the total order and conflicts with v must be complete before v starts.
    Occupancies are swept, from the configuration before a node to its own, so the edge starts at
    that last conflicting node itself: once it is complete its robot stands at the start of the
    next node, which is clear of v. With the paper's point occupancies that is its successor rule.

    Args:
        nodes: a graph whose edges are not looked at.
        task_edges: what is known to precede; not searched again.
        progress: called after each ordered pair of robots with pairs done and in all, by the
            thread that searched it.
    """
    implied, _ = order_and_reduce(nodes.ranks, task_edges)
    occupancies = nodes.occupancies
    todo = list(permutations(range(len(occupancies)), 2))
    done = count(1)

    def search(pair: tuple[int, int]) -> list[tuple[int, int, int, int]]:
        i, k = pair
        floor = implied.last_before(i, k).copy()
        limit = nodes_before(nodes.ranks, i, k)
        own, other = occupancies[i], occupancies[k]
        found = search_conflicts(own, other, floor, limit, nodes.table)
        edges = [(k, u, i, v) for v, u in found]
        progress(next(done), len(todo))
        return edges

    edges = {edge for found in side_by_side(search, todo) for edge in found}
    return np.array(sorted(edges), dtype=np.int64).reshape(-1, 4)
