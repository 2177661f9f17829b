"""Nodes of a temporal plan graph, from the timed paths of a motion plan (APEX-MR IV-C)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from planning.errors import PlanInvariantError
from planning.motion.motion_plan import MotionPlan, TaskMotion
from planning.tasks.task import TRANSIT, Task
from planning.transforms import Array, Indices, readonly
from scheduling.graph.temporal_plan_graph import (
    NodeChain,
    NodeHandling,
    TemporalPlanGraph,
)

_SAME = 1e-9
"""Joint values that differ by less are the same configuration [rad or m]."""


@dataclass(frozen=True)
class _TaskNodes:
    """The nodes of one task.

    Attributes:
        task: the task.
        waypoints: of all nodes, shape (p, n).
        fraction: share of its node's duration that has passed at each waypoint, shape (p,).
        count: waypoints of each node, shape (nodes,).
        skill: True for the node of a skill.
        start, end: of each node in the input plan, shape (nodes,) [s].
        where: node, counted from 0, and waypoint of it that each waypoint of the path became.
        time: of each waypoint of the path [s].
    """

    task: Task
    waypoints: Array
    fraction: Array
    count: Indices
    skill: bool
    start: Array
    end: Array
    where: dict[int, tuple[int, int]]
    time: Array


def build_nodes(plan: MotionPlan) -> TemporalPlanGraph:
    """Return the graph of a plan without type-2 edges: safe only one task after another.

    Each waypoint of a transit but the first becomes a pose node, a skill one node. Pose nodes
    that do not move, waits of the input plan, are dropped (APEX-MR IV-C).

    Raises:
        PlanInvariantError: paths do not join, times fall, or arrays do not fit.
    """
    chains: list[NodeChain] = []
    handlings: list[tuple[float, NodeHandling]] = []
    for robot in plan.cell.robots:
        own = [
            (task, motion)
            for task, motion in zip(plan.tasks, plan.motions, strict=True)
            if task.robot == robot.name
        ]
        parts = _nodes_of_robot(own)
        if any(len(part.count) for part in parts):
            handlings += _handlings(parts, len(chains))
            chains.append(_chain(robot.name, np.asarray(own[0][1].path[0]), parts))
    handlings.sort(key=lambda item: item[0])
    return TemporalPlanGraph(
        plan.cell,
        plan.tasks,
        tuple(chains),
        np.empty((0, 4), dtype=np.int64),
        np.empty(0, dtype=np.uint8),
        tuple(handling for _, handling in handlings),
        plan.allowed,
        np.asarray(plan.dependencies, dtype=np.int64).reshape(-1, 2),
    )


def _nodes_of_robot(own: list[tuple[Task, TaskMotion]]) -> list[_TaskNodes]:
    parts: list[_TaskNodes] = []
    end: Array | None = None
    for task, motion in own:
        path = np.asarray(motion.path, dtype=np.float64)
        time = np.asarray(motion.time, dtype=np.float64)
        _check_arrays(task, path, time)
        if end is not None and np.max(np.abs(path[0] - end)) > _SAME:
            last = next((p.task.index for p in parts[::-1] if len(p.count)), None)
            raise PlanInvariantError(
                f"{_name(task)} starts {np.max(np.abs(path[0] - end)):.3g} away from where"
                f" task {'before it' if last is None else last} ended"
            )
        as_nodes = _poses if task.kind == TRANSIT else _skill
        parts.append(as_nodes(task, path, time))
        end = path[-1]
    return parts


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


def _poses(task: Task, path: Array, time: Array) -> _TaskNodes:
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
    ones = np.ones(len(nodes))
    start = time[np.maximum(nodes - 1, 0)]
    count = ones.astype(np.int64)
    return _TaskNodes(
        task, path[nodes], ones, count, False, start, time[nodes], where, time
    )


def _skill(task: Task, path: Array, time: Array) -> _TaskNodes:
    reference = path[1:] if len(path) > 1 else path
    span = time[-1] - time[0]
    if len(path) > 1 and span > 0.0:
        fraction = (time[1:] - time[0]) / span
    else:
        fraction = np.arange(1, len(reference) + 1) / len(reference)
    fraction[-1] = 1.0
    where = {k: (0, k) for k in range(len(path))}
    count = np.array([len(reference)])
    return _TaskNodes(
        task, reference, fraction, count, True, time[:1], time[-1:], where, time
    )


def _handlings(parts: list[_TaskNodes], chain: int) -> list[tuple[float, NodeHandling]]:
    """Return what changes hands in the nodes of a robot, and when it is planned to [s]."""
    out = []
    first = 0
    for part in parts:
        for h in part.task.handlings:
            node, waypoint = part.where[h.waypoint]
            handling = NodeHandling(
                h.object, chain, first + node, waypoint, h.holder, readonly(h.pose)
            )
            out.append((float(part.time[h.waypoint]), handling))
        first += len(part.count)
    return out


def _chain(robot: str, start: Array, parts: list[_TaskNodes]) -> NodeChain:

    def joined(name: str) -> Array:
        return readonly(np.concatenate([getattr(part, name) for part in parts]))

    lengths = [len(part.count) for part in parts]
    counts = np.concatenate([part.count for part in parts])
    return NodeChain(
        robot,
        readonly(start),
        joined("waypoints"),
        joined("fraction"),
        _frozen(np.cumsum([0, *counts], dtype=np.int64)),
        _frozen(np.repeat([part.task.index for part in parts], lengths)),
        _frozen(np.repeat([part.skill for part in parts], lengths)),
        readonly(joined("end") - joined("start")),
        joined("start"),
    )


def _frozen(values: npt.NDArray[Any]) -> npt.NDArray[Any]:
    values.setflags(write=False)
    return values
