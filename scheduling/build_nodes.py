"""Nodes of a temporal plan graph, from the timed paths of a motion plan (APEX-MR IV-C)."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from planning.errors import PlanInvariantError
from planning.motion.motion_plan import MotionPlan, TaskMotion
from planning.tasks.task import Task, TaskKind, still_borders
from planning.transforms import Array, Indices, read_only_copy
from scheduling.graph.temporal_plan_graph import (
    NO_EDGES,
    NodeChain,
    NodeHandling,
    TemporalPlanGraph,
    join_chains,
)

_SAME = 1e-9
"""Joint values that differ by less are the same configuration [rad or m]."""

_Where = dict[int, tuple[int, int]]
"""Node, counted from 0, and waypoint of it that each waypoint of a task's path became."""


def build_nodes(plan: MotionPlan) -> TemporalPlanGraph:
    """Return the graph of a plan without type-2 edges: safe only in sequential execution.

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
    """Return the nodes of each task of a robot, and the handlings in them, with their times [s]."""
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
        as_nodes = _poses if task.kind == TaskKind.TRANSIT else _skill
        nodes, where = as_nodes(task, path, time)
        for h in task.handlings:
            node, waypoint = where[h.waypoint]
            handling = NodeHandling(
                h.object,
                chain,
                first + node,
                waypoint,
                h.holder,
                read_only_copy(h.pose),
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
    """Return a node for every waypoint that the robot moves to or handles an object at."""
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
    """Return a node for each motion of a skill, and for each interval in which a tool closes or opens.

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
        np.full(len(start), task.kind != TaskKind.TRANSIT),
        end - start,
        start,
    )
