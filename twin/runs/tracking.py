"""Tracking errors of robots moved by drivers: their distance to planned paths, and the nearest path points."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from planning.kinematics.kinematics import frame_pose
from planning.motion.near_path import nearest_points_on_path
from planning.transforms import Array
from scheduling.graph.temporal_plan_graph import NodeChain, TemporalPlanGraph
from twin.durations.nanoseconds import Nanoseconds
from twin.runs.execution_record import Measured


class TrackingError(NamedTuple):
    """Largest tracking error of a robot.

    Attributes:
        joint: largest error of a joint [rad or m].
        tool_m: largest distance of the tool from its position on the path [m].
    """

    joint: float
    tool_m: float


def nearest_on_path(chain: NodeChain, q: Array, node: Nanoseconds) -> Array:
    """Return the points of a path nearest to measured configurations.

    Args:
        chain: the path.
        q: measured joint positions, shape (k, n).
        node: in which each was measured, -1 before the first, shape (k,). Its neighbours count, too: a
            corner may be cut, and a border be noticed late.

    Returns:
        Shape (k, n).
    """
    found = np.empty_like(q)
    for n in np.unique(node).tolist():
        low, high = max(n - 1, 0), min(max(n, 0) + 2, len(chain))
        rows, own = node == n, chain.waypoints[chain.first[low] : chain.first[high]]
        found[rows] = nearest_points_on_path(
            np.vstack([chain.stands_at(low), own]), q[rows]
        ).q
    return found


def tracking_errors(
    tpg: TemporalPlanGraph, measured: Mapping[str, Measured]
) -> dict[str, TrackingError]:
    """Return the largest tracking error of each measured robot.

    Args:
        tpg: the executed plan.
        measured: where robots were, by name.
    """
    found = {}
    for name, own in measured.items():
        k = tpg.chain_index.get(name)
        if k is None or not len(own.t_ns):
            continue
        near = nearest_on_path(tpg.chains[k], own.q, own.node)
        off = np.abs(near - own.q).max(axis=1)
        robot = tpg.cell.robot(name)
        ends = [
            np.array([frame_pose(robot, q, "tool")[:3, 3] for q in rows])
            for rows in (own.q, near)
        ]
        tool_m = np.linalg.norm(ends[0] - ends[1], axis=1)
        found[name] = TrackingError(float(off.max()), float(tool_m.max()))
    return found
