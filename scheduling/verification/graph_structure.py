"""The structure of a saved plan: no cycle, the planned order, and objects passed on in order."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from planning.transforms import Indices
from scheduling.graph.temporal_plan_graph import (
    NodeHandling,
    TemporalPlanGraph,
)
from scheduling.verification.ancestors import Precedence, find_precedence
from scheduling.verification.findings import Moment, Problem
from scheduling.verification.object_places import (
    handled_objects,
    planned_key,
    stand_during,
)


def check_structure(
    tpg: TemporalPlanGraph,
) -> tuple[Precedence | None, list[Problem]]:
    """Check order, handlings and dependencies.

    Args:
        tpg: the plan.

    Returns:
        What precedes what, None if there is a cycle, and the problems.
    """
    check = _Structure(tpg)
    return check.structure(), check.problems


class _Structure:
    def __init__(self, tpg: TemporalPlanGraph) -> None:
        self.tpg = tpg
        self.problems: list[Problem] = []

    def structure(self) -> Precedence | None:
        """Check order and dependencies; return what precedes what."""
        tpg = self.tpg
        precedence = find_precedence(tpg)
        if precedence is None:
            self.problems.append(Problem("cycle", "the edges form a cycle"))
            return None
        for a, chain in enumerate(tpg.chains):
            keys = [planned_key(tpg, a, v) for v in range(len(chain))]
            for v in range(1, len(keys)):
                if keys[v] < keys[v - 1]:
                    self._ordered(
                        "order", (a, v - 1), (a, v), "against the planned order"
                    )
        for a, u, b, v in tpg.edges.tolist():
            if planned_key(tpg, a, u) >= planned_key(tpg, b, v):
                self._ordered(
                    "order", (a, u), (b, v), "an edge against the planned order"
                )
        for name, events in handled_objects(tpg).items():
            for before, after in pairwise(events):
                a, u, b, v = before.robot, before.node, after.robot, after.node
                if a != b and not precedence.precedes(a, u, b, v):
                    text = f"both handle {name!r} and are not ordered"
                    self._ordered("handling", (a, u), (b, v), text)
            self._passing(name, events, precedence)
        self._dependencies(precedence, self.tpg.dependencies)
        return precedence

    def _passing(
        self, name: str, events: list[NodeHandling], precedence: Precedence
    ) -> None:
        """Check that a robot stands still while another one gives it something or takes it."""
        index = {chain.robot: i for i, chain in enumerate(self.tpg.chains)}
        holder: str | None = None
        for event in events:
            a, u = event.robot, event.node
            for robot in {holder, event.holder} - {None, self.tpg.chains[a].robot}:
                b = index[str(robot)]
                v = stand_during(self.tpg, b, (a, u, event.waypoint))[1]
                text = f"{name!r} is passed on and {robot!r} need not stand then"
                if v > 0 and not precedence.precedes(b, v - 1, a, u):
                    self._ordered("handling", (b, v - 1), (a, u), text)
                if v < len(self.tpg.chains[b]) and not precedence.precedes(a, u, b, v):
                    self._ordered("handling", (a, u), (b, v), text)
            holder = event.holder

    def _dependencies(self, precedence: Precedence, dependencies: Indices) -> None:
        nodes: dict[int, tuple[int, int, int]] = {}
        for a, chain in enumerate(self.tpg.chains):
            for task in np.unique(chain.task).tolist():
                own = np.flatnonzero(chain.task == task)
                nodes[task] = (a, int(own[0]), int(own[-1]))
        for first, second in np.asarray(dependencies).reshape(-1, 2).tolist():
            if first in nodes and second in nodes:
                a, _, u = nodes[first]
                b, v, _ = nodes[second]
                if not precedence.precedes(a, u, b, v):
                    text = f"task {second} must wait for task {first}, and does not"
                    self._ordered("dependency", (a, u), (b, v), text)

    def _ordered(
        self, kind: str, u: tuple[int, int], v: tuple[int, int], text: str
    ) -> None:
        first, second = (
            Moment(chain.robot, node, int(chain.task[node]), False, chain.robot)
            for chain, node in ((self.tpg.chains[a], n) for a, n in (u, v))
        )
        names = [
            f"node {m.node} of {m.robot!r} (task {m.task})" for m in (first, second)
        ]
        message = f"{names[0]} and {names[1]}: {text}"
        self.problems.append(Problem(kind, message, first, second))
