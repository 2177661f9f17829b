"""Runs of pose nodes that may be shortened, and candidate paths in their place (APEX-MR IV-C).

Consecutive transits are one run, so HOME between them can be skipped. A run ends at a skill,
where the robot's load changes, at a goal that is to be reached for its own sake, and where a
robot waits for, or is waited for by, another one's task: a shortcut must neither skip such a
place nor let anyone pass it too early.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planning.motion.speed import SpeedModel, sample_path
from planning.transforms import Array
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.graph.temporal_plan_graph import NodeChain


@dataclass(frozen=True)
class Span:
    """Pose nodes ``first`` to ``last`` of a chain, both included.

    The node before ``first`` exists: out-edges of skipped nodes move to it.
    """

    chain: int
    first: int
    last: int


def find_spans(graph: DerivedTpg) -> list[Span]:
    """Return the runs of at least two pose nodes, chain by chain, in order."""
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
                    out.append(Span(index, first, node - 1))
                first = node if node < count and pose[node] else node + 1
    return out


LINE, CORNER, JOINT = "line", "corner", "joint"

SHAPES = (LINE, LINE, CORNER, CORNER, JOINT)
"""Shapes of candidates, each as likely as it stands here."""


def candidate_path(old: Array, shape: str, rng: np.random.Generator) -> Array:
    """Return a random polyline with the same ends.

    Args:
        old: waypoints of the way so far, shape (w, n).
        shape: one of SHAPES.
        rng: of corners and joints.
    """
    if shape == LINE:
        return old[[0, -1]]
    if shape == CORNER:
        return _with_corner(old, rng)
    return _straighten(old, int(rng.integers(old.shape[1])))


def _with_corner(path: Array, rng: np.random.Generator) -> Array:
    """Return a polyline of the same ends over a corner somewhere between both.

    No joint goes further than on the straight line, so under the L1 speed model it takes no
    longer; but it passes elsewhere.
    """
    share = rng.random(path.shape[1])
    if rng.random() < 0.5:
        share = np.round(share)
    corner = path[0] + share * (path[-1] - path[0])
    return np.array([path[0], corner, path[-1]])


def _straighten(path: Array, joint: int) -> Array:
    """Return a polyline in which one joint goes straight from its first to its last value."""
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
) -> NodeChain:
    """Return the nodes of a path, as a chain of their own.

    Each has the task and the planned start of the node that was as far on the way before.

    Args:
        chain: whose nodes ``first`` to ``last`` are to be replaced.
        first, last: those nodes.
        path: polyline of the same ends, shape (w, n).
        speed: speed model of the robot.
        step: longest time between nodes [s].
    """
    waypoints, times = sample_path(path, speed, step)
    duration = np.diff(times)
    share = times[1:] / times[-1]
    old_end = np.cumsum(chain.duration[first : last + 1])
    at = first + np.searchsorted(old_end / old_end[-1], np.minimum(share, 1.0) - 1e-12)
    at = np.minimum(at, last)
    task = np.maximum.accumulate(chain.task[at])
    count = len(duration)
    return NodeChain(
        chain.robot,
        waypoints[0],
        waypoints[1:],
        np.ones(count),
        np.arange(count + 1),
        task,
        np.zeros(count, dtype=np.bool_),
        duration,
        np.maximum.accumulate(chain.planned_start[at]),
    )
