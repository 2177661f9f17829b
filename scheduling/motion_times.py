"""Durations of motions within the robots' limits of speed, acceleration and jerk.

Durations are computed without waits. The simulation engines add waits, with the same functions of
``planning.timing.stretch``.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from planning.caches import BoundedCache
from planning.cell.motion_limits import MotionLimits
from planning.kernels import kernel
from planning.timing.smooth_path import SmoothPath, smooth_path
from planning.timing.stretch import exit_bound, passage_seconds
from planning.transforms import Array, Indices
from scheduling.graph.actuations import chain_actuations
from scheduling.graph.temporal_plan_graph import (
    Drive,
    NodeChain,
    TemporalPlanGraph,
    joined_drives,
)
from scheduling.pace import Pace, paces
from scheduling.stretch_times import (
    chain_bends,
    node_ends,
    straight_drive,
    stretch_drive,
)

_STILL = 1e-12
"""Joint values that differ by less are the same [rad or m]."""

_TURN = 1e-7
"""Unit directions that differ by less are the same straight line."""


_KNOWN: BoundedCache[SmoothPath] = BoundedCache(2000)
"""Motions of skills, which plans of the same products share, by limits, path and stops."""


def assign_node_times(tpg: TemporalPlanGraph) -> TemporalPlanGraph:
    """Return a graph whose nodes have the durations that their robots' limits require.

    Order, paths and edges stay as they are. Chains of robots without limits, and of machines, too.
    """
    if all(robot.limits is None for robot in tpg.cell.robots):
        return tpg
    chains = tuple(
        tpg.chains[k] if pace is None else _timed(tpg, k, pace)
        for k, pace in enumerate(paces(tpg))
    )
    return replace(tpg, chains=chains)


def is_driven(tpg: TemporalPlanGraph) -> bool:
    """Tell whether some robot of a graph has limits of acceleration."""
    return any(chain.drive is not None for chain in tpg.chains)


def with_full_speed_times(tpg: TemporalPlanGraph) -> TemporalPlanGraph:
    """Return a graph with the durations of pose nodes at the speed at which they may be passed.

    No node may take less than it does at least. That is what durations are drawn of; the engines
    make nodes longer where robots speed up or slow down.
    """
    chains = []
    for chain in tpg.chains:
        drive = chain.drive
        if drive is None:
            chains.append(chain)
            continue
        duration = np.where(drive.ramp > 0.0, drive.least, chain.duration)
        chains.append(replace(chain, duration=duration, least=drive.least))
    return replace(tpg, chains=tuple(chains))


def skill_motion(
    tpg: TemporalPlanGraph, k: int, node: int, limits: MotionLimits
) -> SmoothPath:
    """Return the motion of a robot along the reference path of one of its skill nodes.

    Args:
        tpg: the graph.
        k: index of the chain.
        node: the skill node.
        limits: of the robot.
    """
    chain = tpg.chains[k]
    stops = {h.waypoint for h in tpg.handlings if h.robot == k and h.node == node}
    path = node_path(chain, node)
    own = (np.asarray(value).tobytes() for value in vars(limits).values())
    key = *own, path.tobytes(), *sorted(stops)
    return _KNOWN.get(key, lambda: smooth_path(limits, path, stops))


def node_path(chain: NodeChain, node: int) -> Array:
    """Return the path of a node from its start configuration, shape (w, n)."""
    own = chain.waypoints[chain.first[node] : chain.first[node + 1]]
    return np.vstack([chain.stands_at(node), own])


def _timed(tpg: TemporalPlanGraph, k: int, pace: Pace) -> NodeChain:
    """Return a chain with the durations that its robot's limits require."""
    chain = tpg.chains[k]
    acts = chain_actuations(tpg, k)
    begins = np.flatnonzero(np.diff(stretch_numbers(tpg, k), prepend=-1))
    fraction, duration = chain.fraction.copy(), chain.duration.copy()
    drives = []
    for begin, stop in pairwise([*begins.tolist(), len(chain)]):
        if not chain.skill[begin]:
            drives.append(stretch_drive(pace, chain, begin, stop))
            continue
        motion = skill_motion(tpg, k, begin, pace.limits)
        slowing = pace.skill(begin, motion)
        least = np.array([motion.seconds * slowing.factor])
        drives.append(straight_drive(least, slowing))
        duration[begin:stop] = np.maximum(duration[begin:stop], least)
        if motion.seconds > 0.0:
            own = slice(chain.first[begin], chain.first[stop])
            fraction[own] = motion.passed[1:] / motion.seconds
    drive = joined_drives(drives)
    for nodes in _without_actuation_times(chain, acts):
        # What the skill takes in all is shared as its motions need it.
        least = drive.cruise[nodes]
        whole = max(chain.duration[nodes].sum(), least.sum())
        duration[nodes] = least * (whole / max(least.sum(), _STILL))
    moving = drive.ramp > 0.0
    duration[moving] = nominal_durations(drive)[moving]
    duration[~moving & ~chain.skill] = 0.0
    return replace(chain, duration=duration, fraction=fraction, drive=drive)


def _without_actuation_times(
    chain: NodeChain, acts: Collection[int]
) -> Iterator[Indices]:
    """Yield the nodes of each skill that are actuations without a duration of their own."""
    for task in np.unique(chain.task[list(acts)]).tolist():
        nodes = np.flatnonzero(chain.task == task)
        if not chain.duration[nodes[np.isin(nodes, list(acts))]].any():
            yield nodes


def stretch_numbers(tpg: TemporalPlanGraph, k: int) -> Indices:
    """Return the number of each node's stretch, from 0, shape (nodes,).

    Nodes that are no part of a stretch have a number of their own.

    Args:
        tpg: the graph.
        k: index of the chain.
    """
    chain = tpg.chains[k]
    ends = node_ends(chain, 0, len(chain))
    displacement = np.diff(ends, axis=0)
    leave, enter = _directions(displacement), _directions(displacement)
    inside = np.zeros(max(len(chain) - 1, 0), dtype=np.bool_)
    moves = (np.linalg.norm(displacement, axis=1) > _STILL) & ~chain.skill
    for bend in chain_bends(chain):
        begin, stop = bend.begin, bend.stop
        enter[begin] = _directions(bend.corner[:1] - ends[begin])[0]
        leave[stop - 1] = _directions(ends[stop] - bend.corner[-1:])[0]
        inside[begin : stop - 1] = True
        # Where a way turns back, a node may end where it began.
        moves[begin:stop] = True
    joined = moves[1:] & moves[:-1]
    turn = np.abs(enter[1:] - leave[:-1]).max(axis=1, initial=0.0)
    joined &= inside | (turn < _TURN)
    for handling in tpg.handlings:
        # What changes hands does so at rest.
        if handling.robot == k and not chain.skill[handling.node]:
            border = handling.node - (handling.waypoint == 0)
            if 0 <= border < len(joined):
                joined[border] = False
    return np.concatenate([[0], np.cumsum(~joined)])[: len(chain)].astype(np.int64)


def _directions(displacements: Array) -> Array:
    """Return unit directions of displacements, shape (w, n)."""
    lengths = np.linalg.norm(displacements, axis=1)
    return np.asarray(displacements / np.maximum(lengths, _STILL)[:, None])


def nominal_durations(drive: Drive) -> Array:
    """Return node durations without waits within a stretch; 0 if in none [s]."""
    return _nominal(drive.cruise, drive.cap, drive.ramp, drive.lag, drive.rests)


@kernel
def _nominal(
    cruise: Array, cap: Array, ramp: Array, lag: Array, rests: npt.NDArray[np.bool_]
) -> Array:
    out = np.zeros_like(cruise)
    begin = 0
    for end in range(len(cruise)):
        if not rests[end]:
            continue
        speed = 0.0
        for node in range(begin, end + 1):
            if ramp[node] > 0.0:
                bound = exit_bound(cruise, cap, node, end, ramp)
                out[node], speed, _ = passage_seconds(
                    cruise[node], cap[node], speed, bound, ramp[node]
                )
        out[begin] += lag[begin]
        begin = end + 1
    return out
