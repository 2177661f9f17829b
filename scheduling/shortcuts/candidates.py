"""Spans of transits that may be shortened, and candidate paths that may replace them (APEX-MR, section IV-C).

A span consists of consecutive transits, so a shortcut can skip the home configuration between them. It ends at a
skill, where the load of the robot changes, at an explicit goal, and at a task that waits for another robot or for
which another robot waits. A shortcut must not skip such a point.

During the shortcut search, a new path has as many nodes as the path that it replaces. At the end, adjacent
nodes on one straight line are merged if no wait changes: the first has no successors on other robots, and the
second has no predecessors there. The merged node has the same swept volume.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from planning.motion.speed import SpeedModel, cut_path
from planning.transforms import Array, Indices
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.graph.temporal_plan_graph import (
    NodeChain,
    TemporalPlanGraph,
    pose_nodes,
)

LINE, CORNER, JOINT, SMOOTH = "line", "corner", "joint", "smooth"

SHAPES = (LINE, SMOOTH, CORNER, CORNER, JOINT)
"""Shapes of candidates, drawn with equal probability; CORNER is listed twice."""

_STRAIGHT = 1e-9
"""Directions whose components differ by less, the largest being 1, are the same."""

_ON_THE_WAY = 1e-9
"""Greatest distance of a removed waypoint from the straight line [rad or m]."""


@dataclass(frozen=True)
class TransitSpan:
    """Span of consecutive transits: pose nodes ``first`` to ``last`` of a chain, both included.

    The node before ``first`` exists: out-edges of skipped nodes move to it.
    """

    chain: int
    first: int
    last: int


def find_spans(graph: DerivedTpg) -> list[TransitSpan]:
    """Return the transit spans of at least two pose nodes, chain by chain, in order."""
    tpg = graph.tpg
    robot_of = {task.index: task.robot for task in tpg.tasks}
    between = [
        (int(a), int(b)) for a, b in tpg.dependencies if robot_of[a] != robot_of[b]
    ]
    goals = {task.index for task in tpg.tasks if task.goal}
    sources = {a for a, _ in between} | goals
    targets = {b for _, b in between}
    out = []
    for index, chain in enumerate(tpg.chains):
        count = len(chain)
        pose = ~chain.skill
        for handling in tpg.handlings:
            if handling.robot == index:
                pose[handling.node] = False
        breaks = np.zeros(count + 1, dtype=np.bool_)
        changes = np.flatnonzero(np.diff(chain.task)) + 1
        for node in changes.tolist():
            before, after = int(chain.task[node - 1]), int(chain.task[node])
            breaks[node] = before in sources or after in targets
            # Its wait must stay in front of all that follows: the node is not replaced.
            pose[node] &= after not in targets
        for span in graph.spans[index]:
            breaks[span.start[0]] = True
            pose[span.start[0] : span.start[0] + 1] = False
        first = 1
        for node in range(1, count + 1):
            if node == count or not pose[node] or breaks[node]:
                if node - first >= 2 and pose[first]:
                    out.append(TransitSpan(index, first, node - 1))
                first = node if node < count and pose[node] else node + 1
    return out


def candidate_path(old: Array, shape: str, rng: np.random.Generator) -> Array:
    """Return a random polyline with the same ends.

    Args:
        old: waypoints of the current path, shape (w, n).
        shape: one of SHAPES.
        rng: of corners and joints.
    """
    if shape == LINE:
        return old[[0, -1]]
    if shape == CORNER:
        return _with_corner(old, rng)
    return _straighten(remove_waypoints_on_lines(old), int(rng.integers(old.shape[1])))


def _with_corner(path: Array, rng: np.random.Generator) -> Array:
    """Return a polyline with the same ends over a corner between them.

    No joint goes further than on the straight line, so under the L1 speed model it takes no
    longer; but it passes elsewhere.
    """
    share = rng.random(path.shape[1])
    if rng.random() < 0.5:
        share = np.round(share)
    corner = path[0] + share * (path[-1] - path[0])
    return np.array([path[0], corner, path[-1]])


def _straighten(path: Array, joint: int) -> Array:
    """Return a polyline in which one joint moves straight from its first to its last value."""
    out = path.copy()
    travel = np.abs(np.diff(path, axis=0)).sum(axis=1)
    share = np.concatenate([[0.0], np.cumsum(travel)])
    if share[-1] > 0.0:
        out[:, joint] = path[0, joint] + share / share[-1] * (
            path[-1, joint] - path[0, joint]
        )
    return out


def new_nodes(
    chain: NodeChain, first: int, last: int, path: Array, speed: SpeedModel, step: float
) -> NodeChain | None:
    """Return as many nodes along another path, as a chain of their own, None if they do not suffice.

    Each has the task and the planned start of the node that it replaces.

    Args:
        chain: whose nodes ``first`` to ``last`` are to be replaced.
        first, last: those nodes.
        path: polyline of the same ends, shape (w, n).
        speed: speed model of the robot.
        step: longest time between nodes [s].
    """
    count = last - first + 1
    sampled = cut_path(path, speed, step, count)
    if sampled is None:
        return None
    waypoints, duration = sampled
    own = slice(first, last + 1)
    task, start = chain.task[own], chain.planned_start[own]
    return pose_nodes(chain.robot, path[0], waypoints, task, duration, start)


def remove_waypoints_on_lines(path: Array) -> Array:
    """Return a polyline without the waypoints on the straight line between their neighbours."""
    distance = np.diff(path, axis=0)
    far = np.abs(distance).max(axis=1)
    kept = [0]
    along = None
    for k, (step, size) in enumerate(zip(distance, far.tolist(), strict=True)):
        if size == 0.0:
            continue
        direction = step / size
        if along is not None and np.max(np.abs(direction - along)) > _STRAIGHT:
            kept.append(k)
        along = direction
    return path[[*kept, len(path) - 1]]


def join_nodes(
    graph: DerivedTpg, spans: Sequence[TransitSpan], step: float
) -> TemporalPlanGraph:
    """Return an equivalent graph with fewer nodes.

    Args:
        graph: the graph.
        spans: transit spans in which nodes may be joined.
        step: longest time between pose nodes [s].
    """
    tpg = graph.tpg
    number, chains = [], []
    for index, chain in enumerate(tpg.chains):
        last = _last_nodes(chain, _borders(graph, spans, index), step)
        number.append(np.searchsorted(last, np.arange(len(chain))))
        chains.append(_joined(chain, last))
    edges = tpg.edges.copy()
    for end in (0, 2):
        for index, numbers in enumerate(number):
            own = edges[:, end] == index
            edges[own, end + 1] = numbers[edges[own, end + 1]]
    handlings = tuple(
        replace(h, node=int(number[h.robot][h.node])) for h in tpg.handlings
    )
    return replace(tpg, chains=tuple(chains), edges=edges, handlings=handlings)


def _borders(
    graph: DerivedTpg, spans: Sequence[TransitSpan], index: int
) -> npt.NDArray[np.bool_]:
    """Return for each node whether it must stay separate from the next one."""
    edges, chain = graph.tpg.edges, graph.tpg.chains[index]
    stays = np.ones(len(chain), dtype=np.bool_)
    for span in spans:
        if span.chain == index:
            stays[span.first : span.last] = False
    stays[edges[edges[:, 0] == index, 1]] = True
    stays[np.maximum(edges[edges[:, 2] == index, 3] - 1, 0)] = True
    stays[:-1] |= chain.task[1:] != chain.task[:-1]
    # Another robot's handling in between asks where this one stands: see ``trace_objects``.
    for handling in graph.tpg.handlings:
        if handling.robot != index:
            rank = graph.ranks[handling.robot][handling.node]
            stays[max(int(np.searchsorted(graph.ranks[index], rank)) - 1, 0)] = True
    return stays


def _last_nodes(chain: NodeChain, stays: npt.NDArray[np.bool_], step: float) -> Indices:
    """Return the last of the merged nodes of each new one."""
    out: list[int] = []
    begin, taken = 0, 0.0
    for node in range(len(chain)):
        taken += float(chain.duration[node])
        more = node + 1 < len(chain) and not stays[node]
        if (
            more
            and taken + chain.duration[node + 1] <= step * (1.0 + 1e-9)
            and _straight(chain, begin, node + 1)
        ):
            continue
        out.append(node)
        begin, taken = node + 1, 0.0
    return np.array(out, dtype=np.int64)


def _straight(chain: NodeChain, begin: int, end: int) -> bool:
    """Tell whether pose nodes lead straight from the start of one to the end of another."""
    at = chain.first[begin]
    points = chain.waypoints[at - 1 : chain.first[end + 1]]
    share = np.cumsum(chain.duration[begin : end + 1])
    if at == 0 or len(points) != end - begin + 2 or share[-1] <= 0.0:
        return False
    distance = points[0] + (share / share[-1])[:, None] * (points[-1] - points[0])
    return bool(np.max(np.abs(points[1:] - distance)) <= _ON_THE_WAY)


def _joined(chain: NodeChain, last: Indices) -> NodeChain:
    """Return a chain in which nodes are merged up to each given last one."""
    first = np.append(0, last[:-1] + 1)
    kept = np.ones(len(chain.waypoints), dtype=np.bool_)
    for a, b in zip(first.tolist(), last.tolist(), strict=True):
        if a < b:
            kept[chain.first[a] : chain.first[b]] = False
    passed = np.append(0, np.cumsum(kept))
    return NodeChain(
        chain.robot,
        chain.start,
        chain.waypoints[kept],
        chain.fraction[kept],
        np.append(0, passed[chain.first[last + 1]]),
        chain.task[first],
        chain.skill[first],
        np.add.reduceat(chain.duration, first),
        chain.planned_start[first],
    )
