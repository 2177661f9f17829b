"""The guarantee of a temporal plan graph, checked on the graph itself.

(a) Two nodes of different robots that conflict are ordered. (b) A node that conflicts with a
robot standing between its nodes u and u + 1, before its first or after its last, precedes u or
follows u + 1. (c) A node that conflicts with an object at rest is ordered before its place or
after its pick. Then no delay whatever can bring two robots closer than the clearance.

With (a), a node v can break (b) or (c) only where u ~> v ~> u + 1: everything else conflicts
with u or u + 1 as well, whose swept occupancies contain the hold. Only those are looked at.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planning.errors import PlanInvariantError
from planning.geometry.exact import TOLERANCE
from planning.parallel import side_by_side
from planning.transforms import Indices
from scheduling.conflicts.allowed_contacts import (
    ContactTable,
    EntityNumbers,
    contact_table,
)
from scheduling.conflicts.conflict_search import HullChecker, search_conflicts
from scheduling.conflicts.object_spans import Node, Rest, trace_objects, while_at_rest
from scheduling.conflicts.occupancy import (
    Occupancy,
    chain_occupancy,
    hold_occupancy,
    rest_occupancy,
    standing_occupancy,
)
from scheduling.graph.reduction import NodeOrder, order_and_reduce
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.graph.total_order import planned_ranks


def check_invariant(
    tpg: TemporalPlanGraph,
    *,
    occupancies: Sequence[Occupancy] | None = None,
    searched: bool = False,
) -> None:
    """Check that a graph is safe whatever is delayed.

    The exact decision calls close what is within its tolerance of the clearance. That only
    adds an edge where edges are drawn; here it would refuse a good plan, so the tolerance is
    taken off the clearance.

    Args:
        tpg: the graph.
        occupancies: of its chains, where they are known already.
        searched: True when the edges come straight from ``find_motion_edges`` over these
            occupancies: that search has refused every pair of nodes that its edges do not
            order, so (a) holds and is not searched a second time.

    Raises:
        PlanInvariantError: names the two nodes, or the node and what stands, that are not
            kept apart.
    """
    check = _Check(tpg, occupancies)
    check.objects_in_order()
    if not searched:
        check.nodes()
    check.holds()
    check.robots_without_nodes()
    check.rests()


class _Check:
    def __init__(
        self, tpg: TemporalPlanGraph, occupancies: Sequence[Occupancy] | None
    ) -> None:
        self.tpg = tpg
        ranks = planned_ranks(tpg.chains)
        self.order: NodeOrder = order_and_reduce(ranks, tpg.edges)[0]
        handled = dict.fromkeys(handling.object for handling in tpg.handlings)
        self.entities = EntityNumbers((r.name for r in tpg.cell.robots), handled)
        self.table: ContactTable = contact_table(
            self.entities, tpg.allowed, tpg.cell.clearances
        )
        self.history = trace_objects(tpg, ranks)
        self.checker = HullChecker(self.table, slack=TOLERANCE)
        self.robots = range(len(tpg.chains))
        self.occupancies = occupancies or [
            chain_occupancy(tpg, i, self.history.spans, self.entities)
            for i in self.robots
        ]

    def nodes(self) -> None:
        """Check (a): unordered nodes do not conflict."""
        for i in self.robots:
            for k in range(i):
                floor = np.ascontiguousarray(self.order.last_before(i, k))
                limit = self.order.first_after(i, k)
                for v, u in self._search(self.occupancies[i], k, floor, limit):
                    raise PlanInvariantError(
                        f"{self._name(i, v)} and {self._name(k, u)} conflict and neither"
                        " waits for the other"
                    )

    def holds(self) -> None:
        """Check (b) for robots that have nodes."""
        for k in self.robots:
            count = len(self.tpg.chains[k])
            for i in self.robots:
                if i == k:
                    continue
                other = len(self.tpg.chains[i])
                # Hold h is between nodes h - 1 and h.
                first = np.concatenate([[0], self.order.first_after(k, i)])
                stop = np.concatenate([self.order.last_before(k, i) + 1, [other]])
                holds = np.flatnonzero(first < stop)
                if len(holds) == 0:
                    continue
                standing = hold_occupancy(
                    self.tpg, k, holds, self.history.spans, self.entities
                )
                for h, v in self._search(standing, i, first[holds] - 1, stop[holds]):
                    raise PlanInvariantError(
                        f"{self._name(i, v)} runs into robot"
                        f" {self.tpg.chains[k].robot!r}, which stands"
                        f" {self._between(k, int(holds[h]), count)}"
                    )

    def robots_without_nodes(self) -> None:
        """Check (b) for robots that stand all the time."""
        busy = {chain.robot for chain in self.tpg.chains}
        for robot in self.tpg.cell.robots:
            if robot.name in busy:
                continue
            standing = standing_occupancy(self.tpg, robot, self.entities)
            for i in self.robots:
                floor, limit = np.full(1, -1), np.full(1, len(self.tpg.chains[i]))
                for _, v in self._search(standing, i, floor, limit):
                    raise PlanInvariantError(
                        f"{self._name(i, v)} runs into robot {robot.name!r}, which stands"
                        " at HOME all the time"
                    )

    def objects_in_order(self) -> None:
        """Check that what happens to an object happens in order, whatever is delayed."""
        for rest in self.history.rests:
            pairs = [(rest.after, rest.before), (rest.stood, rest.after)]
            for u, v in pairs:
                if u is None or v is None or self._precedes(u, v):
                    continue
                raise PlanInvariantError(
                    f"{self._name(*v)} handles {rest.object!r} but does not wait for"
                    f" {self._name(*u)}, which does so before"
                )

    def rests(self) -> None:
        """Check (c)."""
        found = side_by_side(self._node_into_rest, self.history.rests)
        for rest, node in zip(self.history.rests, found, strict=True):
            if node is not None:
                raise PlanInvariantError(
                    f"{self._name(*node)} runs into {rest.object!r}"
                    f" {self._rest_name(rest)}"
                )

    def _node_into_rest(self, rest: Rest) -> Node | None:
        """Return a node that runs into an object at rest, if there is one."""
        occupancy = rest_occupancy(self.tpg, rest, self.entities)
        for i in self.robots:
            floor, limit = while_at_rest(self.order, rest, i, len(self.tpg.chains[i]))
            if floor + 1 >= limit:
                continue
            found = self._search(occupancy, i, np.full(1, floor), np.full(1, limit))
            for _, v in found:
                return i, v
        return None

    def _search(
        self, occupancy: Occupancy, robot: int, floor: Indices, limit: Indices
    ) -> list[tuple[int, int]]:
        """Return the first conflict of an occupancy with nodes of a robot, if there is one."""
        found = search_conflicts(
            occupancy,
            self.occupancies[robot],
            np.array(floor, dtype=np.int64),
            np.array(limit, dtype=np.int64),
            self.table,
            self.checker,
        )
        return [first] if (first := next(found, None)) is not None else []

    def _precedes(self, u: Node, v: Node) -> bool:
        if u[0] == v[0]:
            return u[1] <= v[1]
        return self.order.precedes(*u, *v)

    def _name(self, robot: int, node: int) -> str:
        chain = self.tpg.chains[robot]
        task = int(chain.task[node])
        label = next((t.label for t in self.tpg.tasks if t.index == task), "")
        return f"node {node} of robot {chain.robot!r} (task {task}, {label})"

    def _between(self, robot: int, hold: int, count: int) -> str:
        if hold == 0:
            return f"before {self._name(robot, 0)}"
        if hold == count:
            return f"after {self._name(robot, count - 1)}"
        return f"between {self._name(robot, hold - 1)} and {self._name(robot, hold)}"

    def _rest_name(self, rest: Rest) -> str:
        parts = ["at rest" if rest.holder is None else "in a standing robot's hand"]
        if rest.after is not None:
            parts.append(f"after {self._name(*rest.after)}")
        if rest.before is not None:
            parts.append(f"before {self._name(*rest.before)}")
        return " ".join(parts)
