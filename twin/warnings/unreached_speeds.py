"""Warnings about speed factors above 1 that robots cannot reach.

A speed factor multiplies the planned speed. Each warning gives the reached factor and the joints that limit it.
"""

from __future__ import annotations

from collections import defaultdict

import numpy as np

from planning.cell.workcell import PlacedRobot
from planning.transforms import Array
from scheduling.graph.temporal_plan_graph import (
    BY_EFFORT,
    BY_TOOL_SPEED,
    NodeChain,
    TemporalPlanGraph,
)
from scheduling.stretch_times import node_ends
from twin.uncertainty.chain_draws import ChainDraws, RobotTaskNodes
from twin.uncertainty.disturbances import Disturbances
from twin.uncertainty.least_durations import least_seconds

_SAME = 1.0 + 1e-9
"""Times that differ by a smaller factor are the same."""


def unreached_speeds(
    tpg: TemporalPlanGraph, disturbances: Disturbances, seed: int
) -> tuple[str, ...]:
    """Return a message for each robot whose limits do not allow its speed factor above 1.

    Args:
        tpg: the plan.
        disturbances: with speed factors.
        seed: of the run; its replication is 0.
    """
    found = []
    robots = {robot.name: robot for robot in tpg.cell.robots}
    for chain in tpg.chains:
        speed, robot = disturbances.speed.model_of(chain.robot), robots.get(chain.robot)
        if speed is None or robot is None or not len(chain):
            continue
        own = RobotTaskNodes(tpg, chain, {})
        draws = ChainDraws(own, seed, np.zeros(1, dtype=np.int64), disturbances)
        drawn = speed.ppf(draws.draw(np.arange(len(own.tasks)), "speed"))
        factor = drawn[own.of_node, 0]
        wanted = chain.duration / factor
        takes = np.maximum(
            wanted, np.minimum(_least_durations(chain, robot), chain.duration)
        )
        fast = own.moves & (factor > 1.0) & (chain.duration > 0.0)
        bound = fast & (takes > wanted * _SAME)
        if not np.any(bound):
            continue
        whole = chain.duration[fast].sum()
        bound_s = defaultdict[str, float](float)
        if len(chain.waypoints):  # a timing graph has none
            binding = _limiting_quantities(chain, robot)
            for node in np.flatnonzero(bound).tolist():
                bound_s[binding[node]] += float(takes[node])
        most = ", ".join(sorted(bound_s, key=lambda name: -bound_s[name])[:3])
        found.append(
            f"speed.factor of {chain.robot}: {whole / wanted[fast].sum():.3g} times the planned speed is asked"
            f" for, {whole / takes[fast].sum():.3g} times is reached: limits bind in"
            f" {len(np.unique(chain.task[bound]))} of {len(np.unique(chain.task[fast]))} motions"
            f"{most and f', most of them those of {most}'}"
        )
    return tuple(found)


def _least_durations(chain: NodeChain, robot: PlacedRobot) -> Array:
    """Return the shortest durations of nodes at any speed factor, shape (nodes,) [s]."""
    if chain.drive is None:
        return least_seconds(chain, robot.model)
    return np.where(chain.drive.ramp > 0.0, chain.duration, chain.drive.least)


def _limiting_quantities(chain: NodeChain, robot: PlacedRobot) -> list[str]:
    """Return the limiting quantity of each node: a joint, or the speed of the tool."""
    drive, limits, names = chain.drive, robot.limits, robot.model.joint_names
    displacement = np.abs(np.diff(node_ends(chain, 0, len(chain)), axis=0))
    share = displacement / robot.model.velocity
    if drive is None or limits is None:
        return [names[k] for k in np.argmax(share, axis=1)]
    share = displacement / limits.velocity
    moves = drive.ramp > 0.0
    cruise, ramp, lag = (
        np.where(moves, values, 1.0)[:, None]
        for values in (drive.cruise, drive.ramp, drive.lag)
    )
    speed = displacement / cruise
    by_kind = speed / limits.velocity, speed / ramp / limits.acceleration
    shares = np.maximum.reduce([*by_kind, 2.0 * speed / (ramp * lag) / limits.jerk])
    joints = np.argmax(np.where(moves[:, None], shares, share), axis=1)
    found = [names[k] for k in joints]
    for node in np.flatnonzero(drive.slowed_by >= BY_TOOL_SPEED).tolist():
        cause = int(drive.slowed_by[node])
        by_tool = cause == BY_TOOL_SPEED
        found[node] = "the tool's speed" if by_tool else names[cause - BY_EFFORT]
    return found
