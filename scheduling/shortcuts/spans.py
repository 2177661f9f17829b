"""Runs of pose nodes that may be shortened (APEX-MR IV-C).

Consecutive transits are one run, so HOME between them can be skipped. A run ends at a skill,
where the robot's load changes, at a goal that is to be reached for its own sake, and where a
robot waits for, or is waited for by, another one's task: a shortcut must neither skip such a
place nor let anyone pass it too early.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scheduling.conflicts.derived_tpg import DerivedTpg


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
