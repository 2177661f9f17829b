"""State machine over a temporal plan graph that reports which nodes may start. It has no clock.

A node is a piece of the motion of one robot.
"""

from __future__ import annotations

from copy import copy

import numpy as np

from planning.errors import PlanInvariantError
from scheduling.graph.temporal_plan_graph import EVER, TemporalPlanGraph

Node = tuple[int, int]
"""Index of a chain in ``tpg.chains``, and index of a node in this chain."""


class Dispatcher:
    """Reports which nodes may start as others complete (APEX-MR, section IV-D).

    A node is *safe* once every node that precedes it by an edge is complete. A robot works its
    nodes one after the other, so at most one node of each robot is safe and incomplete.

    Args:
        tpg: the graph.
    """

    def __init__(self, tpg: TemporalPlanGraph) -> None:
        self._length = [len(chain) for chain in tpg.chains]
        self._names = [chain.robot for chain in tpg.chains]
        self._first = np.cumsum([0, *self._length]).tolist()
        total = self._first[-1]
        self._chain = np.repeat(np.arange(len(self._length)), self._length).tolist()
        self._unmet = [1] * total
        for first, length in zip(self._first, self._length, strict=False):
            if length:
                self._unmet[first] = 0
        self._successors: dict[int, list[int]] = {}
        self._sources: dict[int, list[int]] = {}
        for r, u, s, v in tpg.edges.tolist():
            source, target = self._first[r] + u, self._first[s] + v
            self._successors.setdefault(source, []).append(target)
            self._sources.setdefault(target, []).append(source)
            self._unmet[target] += 1
        self._done = [0] * len(self._length)
        self._lifted: frozenset[tuple[int, int]] = frozenset()

    def copy(self) -> Dispatcher:
        """Return an independent dispatcher in the same state."""
        twin = copy(self)
        twin._unmet = self._unmet.copy()
        twin._done = self._done.copy()
        return twin

    def ready(self) -> list[Node]:
        """Return every node that is safe and not complete, in the order of the chains."""
        return [
            (robot, done)
            for robot, done in enumerate(self._done)
            if done < self._length[robot]
            and self._unmet[self._first[robot] + done] == 0
        ]

    def is_safe(self, robot: int, node: int) -> bool:
        """Tell whether all predecessors of a node are complete (true also once it is complete itself)."""
        return self._unmet[self._number(robot, node)] == 0

    def complete(self, robot: int, node: int) -> list[Node]:
        """Report a node complete.

        Args:
            robot: index of the chain.
            node: its next incomplete node.

        Returns:
            The nodes that have become safe by it, the robot's own next node first.

        Raises:
            PlanInvariantError: the node is complete already, does not come next, or was not
                safe to start.
        """
        number = self._number(robot, node)
        done = self._done[robot]
        name = self._names[robot]
        if node != done:
            state = "is complete already" if node < done else f"comes after node {done}"
            raise PlanInvariantError(f"robot {name!r}: node {node} {state}")
        if self._unmet[number]:
            edges = ", ".join(
                f"node {u} of {self._names[r]!r}"
                for r, u in self.waits_for(robot, node)
            )
            raise PlanInvariantError(
                f"robot {name!r}: node {node} was completed before {edges}"
            )
        return self._advance(robot)

    def observe(self, robot: int, node: int) -> None:
        """Record that a robot has completed a node, whether it was allowed to or not.

        All its nodes before it count as complete too.
        """
        self._number(robot, node)
        while self._done[robot] <= node:
            self._advance(robot)

    def _advance(self, robot: int) -> list[Node]:
        """Mark a robot's next node as complete; return the nodes that have become safe by it."""
        done = self._done[robot]
        number = self._first[robot] + done
        self._done[robot] = done + 1
        targets = self._successors.get(number, [])
        if self._lifted:
            targets = [t for t in targets if (number, t) not in self._lifted]
        if done + 1 < self._length[robot]:
            targets = [number + 1, *targets]
        safe = []
        for target in targets:
            self._unmet[target] -= 1
            if self._unmet[target] == 0:
                safe.append(self._node(target))
        return safe

    def lift(self, source: Node, target: Node) -> None:
        """Remove a node's wait for an incomplete node; no effect where that is complete."""
        pair = self._number(*source), self._number(*target)
        if source[1] >= self._done[source[0]] and pair not in self._lifted:
            self._lifted = self._lifted | {pair}
            self._unmet[pair[1]] -= 1

    def waits_for(self, robot: int, node: int) -> list[Node]:
        """Return the incomplete sources of a node's type-2 edges."""
        out = []
        number = self._number(robot, node)
        for source in self._sources.get(number, ()):
            r, u = self._node(source)
            if u >= self._done[r] and (source, number) not in self._lifted:
                out.append((r, u))
        return out

    def completed(self, robot: int) -> int:
        """Return the number of complete nodes of a robot."""
        return self._done[robot]

    @property
    def finished(self) -> bool:
        """True once every node is complete."""
        return self._done == self._length

    def _number(self, robot: int, node: int) -> int:
        if not (0 <= robot < len(self._length) and 0 <= node < self._length[robot]):
            raise PlanInvariantError(f"there is no node {node} of chain {robot}")
        number: int = self._first[robot] + node
        return number

    def _node(self, number: int) -> Node:
        robot = self._chain[number]
        return robot, number - self._first[robot]


def timed_edges(tpg: TemporalPlanGraph) -> dict[Node, list[tuple[Node, int]]]:
    """Return the targets of edges with a time limit, by source, with the limit [ns]."""
    found: dict[Node, list[tuple[Node, int]]] = {}
    for k in np.flatnonzero(tpg.patience < EVER).tolist():
        a, u, b, v = tpg.edges[k].tolist()
        found.setdefault((a, u), []).append(((b, v), int(tpg.patience[k])))
    return found
