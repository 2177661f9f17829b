"""Progress of each robot in a run, updated event by event: current node, standstills and attempts."""

from __future__ import annotations

import numpy as np

from twin.durations.nanoseconds import Nanoseconds
from twin.runs.events import Event

STALLED = "stalled"
STOPPED = "stopped"
"""States of a robot that stands still within a node, because of a stall or of a stop such as an emergency stop."""


class RobotProgress:
    """Progress of a robot, updated event by event.

    Attributes:
        name: of the robot.
        start_ns, end_ns: of its nodes, -1 if not yet, shape (nodes,) [ns].
        stood_ns: standstills within each node so far, failed attempts left out, shape (nodes,) [ns].
        took_ns: of nodes that are complete, without standstills and attempts that failed, -1 for what
            has not happened or is not known, shape (nodes,) [ns].
        completed: nodes that it has completed.
        attempt_ns: when the node under way started, or its last attempt [ns].
        attempts: attempts at the node under way that have failed.
        failed: whether its task has failed for good.
    """

    def __init__(self, name: str, nodes: int) -> None:
        """Begin before the first node."""
        self.name = name
        self.start_ns: Nanoseconds = np.full(nodes, -1, dtype=np.int64)
        self.end_ns: Nanoseconds = np.full(nodes, -1, dtype=np.int64)
        self.stood_ns: Nanoseconds = np.zeros(nodes, dtype=np.int64)
        self.took_ns: Nanoseconds = np.full(nodes, -1, dtype=np.int64)
        self.completed = self.attempt_ns = self.attempts = 0
        self.failed = False
        self._stands: list[tuple[str, int, int]] = []

    def continued(self, nodes: int) -> RobotProgress:
        """Return the progress in an extended plan with the given number of nodes of the robot."""
        other = RobotProgress(self.name, nodes)
        kept = slice(min(self.completed + (self.under_way >= 0), nodes))
        other.start_ns[kept], other.end_ns[kept] = (
            self.start_ns[kept],
            self.end_ns[kept],
        )
        other.stood_ns[kept], other.took_ns[kept] = (
            self.stood_ns[kept],
            self.took_ns[kept],
        )
        other.completed = min(self.completed, nodes)
        other.attempt_ns, other.attempts = self.attempt_ns, self.attempts
        other.failed, other._stands = self.failed, self._stands
        return other

    @property
    def standing(self) -> str:
        """STALLED or STOPPED while the robot is, else empty; while it is both, the one that began last."""
        return self._stands[-1][0] if self._stands else ""

    @property
    def standing_in_node(self) -> str:
        """The same as ``standing``, but empty once the node in which that began is complete: braking may pass its end."""
        here = self._stands and self._stands[-1][2] == self.completed
        return self.standing if here else ""

    @property
    def since_ns(self) -> int:
        """Time at which its standstill began [ns]; 0 without one."""
        return self._stands[0][1] if self._stands else 0

    @property
    def under_way(self) -> int:
        """The current node, started and not complete; -1 for none."""
        node = self.completed
        begun = node < len(self.start_ns) and self.start_ns[node] >= 0
        return node if begun else -1

    @property
    def finished(self) -> bool:
        """True once all its nodes are complete."""
        return self.completed == len(self.start_ns)

    def worked_ns(self, now_ns: int) -> int:
        """Return the working time on the current node, without standstills [ns].

        Attempts that failed do not count.
        """
        node = self.under_way
        if node < 0:
            return 0
        begun = max(int(self.start_ns[node]), self.attempt_ns)
        stood = int(self.stood_ns[node])
        if self.standing:
            stood += max(now_ns - max(self.since_ns, begun), 0)
        return max(now_ns - begun - stood, 0)

    def take(self, event: Event) -> None:
        """Update the progress with an event."""
        node, t_ns = event.node, event.t_ns
        if event.kind == "started":
            self.start_ns[node] = self.attempt_ns = t_ns
            self.attempts = 0
        elif event.kind == "completed":
            if self.under_way == node:
                self.took_ns[node] = self.worked_ns(t_ns)
            # A skipped node counts as done immediately, as in a repeated run.
            left = slice(self.completed, node + 1)
            self.start_ns[left] = np.where(
                self.start_ns[left] < 0, t_ns, self.start_ns[left]
            )
            self.end_ns[left] = t_ns
            self.completed = max(self.completed, node + 1)
        elif event.kind in (STALLED, STOPPED):
            self._stands.append((event.kind, t_ns, self.completed))
        elif event.kind == "resumed" and self._stands:
            since_ns = max(self.since_ns, self.attempt_ns)
            self._stands.pop()
            if not self._stands and self.under_way >= 0:
                self.stood_ns[self.under_way] += max(t_ns - since_ns, 0)
        elif event.kind == "retried":
            # Work and standstills of the current node are counted from zero.
            self.attempts += 1
            self.attempt_ns = t_ns
            if self.under_way >= 0:
                self.stood_ns[self.under_way] = 0
        elif event.kind == "failed":
            self.failed = True
        elif event.kind == "recovered":
            # The failed node counts as complete: the revised plan continues after it.
            self.failed = False
            self.end_ns[node] = t_ns
            self.completed = max(self.completed, node + 1)
