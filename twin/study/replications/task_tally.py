"""Tallies of tasks over many replications, in an amount that does not grow with them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planning.transforms import Indices
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.durations import Nanoseconds
from twin.engine.bulk.max_plus import Completions

KEPT = 500
"""Replications whose starts and ends of tasks are kept, for bands on a Gantt chart."""


@dataclass(frozen=True)
class TaskTally:
    """Sums over replications, and samples of the first of them.

    Attributes:
        count: replications counted.
        critical: in how many of them each task was on the critical path, shape (tasks,).
        critical_edges: the same for type-2 edges, shape (edges,).
        slack_ns: sum of the slacks of each task, shape (tasks,) [ns]; -1 where an engine
            cannot tell.
        start_ns, end_ns: of each task in replications below KEPT, shape (k, tasks) [ns].
    """

    count: int
    critical: Indices
    critical_edges: Indices
    slack_ns: Nanoseconds
    start_ns: Nanoseconds
    end_ns: Nanoseconds

    def plus(self, other: TaskTally) -> TaskTally:
        """Return both together; ``other`` has the later replications."""
        known = np.minimum(self.slack_ns, other.slack_ns) >= 0
        return TaskTally(
            self.count + other.count,
            self.critical + other.critical,
            self.critical_edges + other.critical_edges,
            np.where(known, self.slack_ns + other.slack_ns, -1),
            np.concatenate([self.start_ns, other.start_ns]),
            np.concatenate([self.end_ns, other.end_ns]),
        )


@dataclass(frozen=True)
class TaskGroups:
    """Nodes of every task; nodes of all chains are numbered through.

    Attributes:
        task: index of each task that has nodes, in the order of its nodes, shape (tasks,).
        first: its first node, shape (tasks,).
        last: its last node, shape (tasks,).
    """

    task: Indices
    first: Indices
    last: Indices

    def tally(self, replications: Indices, found: Completions) -> TaskTally:
        """Sum up what came of some replications that completed."""
        kept = replications < KEPT
        critical = np.logical_or.reduceat(found.critical, self.first, axis=0)
        slack = np.full(len(self.task), -1, dtype=np.int64)
        if found.slack_ns is not None:
            slack = np.minimum.reduceat(found.slack_ns, self.first, axis=0).sum(axis=1)
        return TaskTally(
            len(replications),
            critical.sum(axis=1).astype(np.int64),
            found.critical_edge.sum(axis=1).astype(np.int64),
            slack,
            np.ascontiguousarray(found.start_ns[self.first][:, kept].T),
            np.ascontiguousarray(found.end_ns[self.last][:, kept].T),
        )


def task_groups(tpg: TemporalPlanGraph) -> TaskGroups:
    """Return the nodes of every task of a graph, contracted or not."""
    task = np.concatenate([chain.task for chain in tpg.chains])
    chain = np.repeat(np.arange(len(tpg.chains)), [len(c) for c in tpg.chains])
    opens = np.diff(task, prepend=-1) != 0
    opens |= np.diff(chain, prepend=-1) != 0
    first = np.flatnonzero(opens)
    last = np.append(first[1:], len(task)) - 1
    return TaskGroups(task[first], first, last)
