"""Conflicts and dependencies between pairs of tasks, independent of the order of the two.

A task that has nodes is called a *unit*; units are numbered robot by robot. A relation between two units is the
same for every interleaving of the tasks of different robots. It is computed on first use and cached.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import defaultdict
from collections.abc import Callable
from itertools import chain as joined

import numpy as np

from planning.transforms import Indices
from scheduling.conflicts.derived_tpg import (
    DerivedTpg,
    Occupant,
    OccupantConflicts,
    Window,
    occupant_of_holds,
    occupant_of_nodes,
    occupant_of_rest,
    occupant_of_standing_robot,
)
from scheduling.conflicts.object_spans import Node, handlings_in_order
from scheduling.graph.task_edges import dependency_edges, task_nodes

Stair = tuple[Indices, Indices]
"""Nodes of the later task, counted from its first one, and for each the node of the earlier
task that must be complete before it."""

_Key = tuple[object, ...]
"""Key of a unit, a hold of a robot, a robot without nodes, or an object at rest."""


class TaskRelations:
    """Relations between the tasks of a graph.

    Args:
        graph: its edges are ignored.
        conflicts: what was found for other graphs of the same cell, and is to be added to; by
            default nothing.

    Attributes:
        graph: the graph.
        units: all units.
        of_chain: units of each chain, in order.
        before: units of other robots that must be complete before each unit.
        left_by, taken_by: numbers of the rests that begin in a unit, and that end in one.
    """

    def __init__(
        self, graph: DerivedTpg, conflicts: OccupantConflicts | None = None
    ) -> None:
        self.graph = graph
        by_chain = task_nodes(graph.tpg.chains)
        self.units = list(joined.from_iterable(by_chain))
        numbers = iter(range(len(self.units)))
        self.of_chain = [[next(numbers) for _ in own] for own in by_chain]
        self._first = [[unit.first for unit in own] for own in by_chain]
        self.before = self._prerequisites()
        self.left_by: dict[int, list[int]] = defaultdict(list)
        self.taken_by: dict[int, list[int]] = defaultdict(list)
        for number, rest in enumerate(graph.history.rests):
            if rest.after is not None:
                self.left_by[self.unit_of(rest.after)].append(number)
            if rest.before is not None:
                self.taken_by[self.unit_of(rest.before)].append(number)
        self._conflicts = conflicts or OccupantConflicts()
        self._occupants: dict[_Key, Occupant] = {}
        self._stairs: dict[tuple[int, int], Stair | None] = {}
        self._clear: dict[tuple[_Key, int], bool] = {}

    def unit_of(self, node: Node) -> int:
        """Return the unit that a node (chain, index) belongs to."""
        chain, index = node
        place = bisect_right(self._first[chain], index) - 1
        return self.of_chain[chain][place]

    def stairs(self, earlier: int, later: int) -> Stair | None:
        """Return the nodes of a unit that wait for another robot's, with their sources; None for none.

        Each node of the later unit waits for the last node of the earlier one that it conflicts
        with; what follows from the stairs below is left out.
        """
        if (earlier, later) not in self._stairs:
            a, b = self.occupant(later), self.occupant(earlier)
            found = self._conflicts.search(self.graph, a, b, _all_nodes(a, b))
            stairs: list[tuple[int, int]] = []
            for v, u in sorted(found):
                if not stairs or u > stairs[-1][1]:
                    stairs.append((v, u))
            rows = np.array(stairs, dtype=np.int64).reshape(-1, 2)
            self._stairs[earlier, later] = (rows[:, 0], rows[:, 1]) if stairs else None
        return self._stairs[earlier, later]

    def sweeps_clear(self, first: int, second: int) -> bool:
        """Tell whether two units of different robots are clear of each other at any times."""
        a, b = sorted((first, second))
        return self._clear_of(("unit", a), lambda: self.occupant(a), b)

    def stands_clear(self, chain: int, done: int, unit: int) -> bool:
        """Tell whether a unit is clear of a robot that has done its first ``done`` units."""
        own = self.of_chain[chain]
        hold = self.units[own[done - 1]].stop if done else 0
        return self._clear_of(
            ("hold", chain, hold),
            lambda: occupant_of_holds(self.graph, chain, np.array([hold])),
            unit,
        )

    def idle_clear(self, robot: str, unit: int) -> bool:
        """Tell whether a unit is clear of a robot without nodes."""
        placed = self.graph.tpg.cell.robot(robot)
        return self._clear_of(
            ("idle", robot),
            lambda: occupant_of_standing_robot(self.graph, placed),
            unit,
        )

    def rest_clear(self, number: int, unit: int) -> bool:
        """Tell whether a unit is clear of an object at rest."""
        rest = self.graph.history.rests[number]
        return self._clear_of(
            ("rest", number), lambda: occupant_of_rest(self.graph, rest), unit
        )

    def occupant(self, unit: int) -> Occupant:
        """Return a unit as an occupant, its nodes counted from its first one."""
        u = self.units[unit]
        return self._cached_occupant(
            ("unit", unit),
            lambda: occupant_of_nodes(self.graph, u.chain, u.first, u.stop),
        )

    def _cached_occupant(self, key: _Key, make: Callable[[], Occupant]) -> Occupant:
        if key not in self._occupants:
            self._occupants[key] = make()
        return self._occupants[key]

    def _clear_of(self, key: _Key, make: Callable[[], Occupant], unit: int) -> bool:
        """Tell whether a unit is clear of a static occupant with a key, created on first use."""
        if (key, unit) not in self._clear:
            a, b = self._cached_occupant(key, make), self.occupant(unit)
            clear = self._conflicts.are_clear(self.graph, a, b, _all_nodes(a, b))
            self._clear[key, unit] = clear
        return self._clear[key, unit]

    def _prerequisites(self) -> list[set[int]]:
        """Return the predecessors of tasks, including the previous holders of their objects."""
        graph, before = self.graph, [set[int]() for _ in self.units]
        for i, u, k, v in dependency_edges(graph.tpg).tolist():
            before[self.unit_of((k, v))].add(self.unit_of((i, u)))
        last: dict[str, int] = {}
        for handling in handlings_in_order(graph.tpg, graph.ranks):
            unit = self.unit_of((handling.robot, handling.node))
            previous = last.get(handling.object, unit)
            if self.units[previous].chain != self.units[unit].chain:
                before[unit].add(previous)
            last[handling.object] = unit
        for rest in graph.history.rests:
            # The standing robot that takes an object in its hand must have come to stand.
            for a, b in ((rest.stood, rest.after), (rest.after, rest.before)):
                if a is not None and b is not None and a[0] != b[0]:
                    before[self.unit_of(b)].add(self.unit_of(a))
        return before


def _all_nodes(a: Occupant, b: Occupant) -> Window:
    """Return an unrestricted search window."""
    floor = np.full(a.nodes, -1, dtype=np.int64)
    return floor, np.full(a.nodes, b.nodes, dtype=np.int64)
