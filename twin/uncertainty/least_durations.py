"""Lower bounds on the durations of nodes, from the speed limits of joints."""

from __future__ import annotations

import numpy as np

from planning.cell.robot_model import RobotModel
from planning.transforms import Array
from scheduling.graph.temporal_plan_graph import NodeChain, TemporalPlanGraph
from twin.durations.nanoseconds import NANOSECONDS, Nanoseconds

_ROUNDING = 1e-9
"""Relative rounding error of a duration computed from a path."""


def least_seconds(chain: NodeChain, model: RobotModel | None) -> Array:
    """Return the least duration of every node that joint speeds allow, shape (nodes,) [s].

    The fractions of a node give the share of its duration for each path segment. The segment with the highest joint
    speed, relative to its limit, determines the least duration. Chains without paths store least durations. Without
    stored values and without a model, they are 0.
    """
    if len(chain.least):
        return chain.least
    if model is None:
        return np.zeros(len(chain))
    before = np.vstack([chain.start[None], chain.waypoints[:-1]])
    passed = np.concatenate([[0.0], chain.fraction[:-1]])
    counts = np.diff(chain.first)
    passed[chain.first[:-1][counts > 0]] = 0.0
    share = chain.fraction - passed
    needed = np.max(
        np.abs(chain.waypoints - before) / model.velocity, axis=1, initial=0.0
    )
    # A stretch without time of its own cannot be made slower by a longer node.
    seconds = np.divide(needed, share, out=np.zeros_like(needed), where=share > 0.0)
    least = np.zeros(len(chain))
    np.maximum.at(least, np.repeat(np.arange(len(chain)), counts), seconds)
    return least


def least_ns(tpg: TemporalPlanGraph) -> tuple[Nanoseconds, ...]:
    """Return the least duration of every node that joint speeds allow, one array a chain [ns]."""
    models = {robot.name: robot.model for robot in tpg.cell.robots}
    out = []
    for chain in tpg.chains:
        seconds = least_seconds(chain, models.get(chain.robot))
        nanoseconds = seconds * NANOSECONDS * (1.0 - _ROUNDING)
        out.append(np.ceil(nanoseconds).astype(np.int64))
    return tuple(out)
