"""Conflicts and dependencies between pairs of tasks, whichever of the two comes first.

Tasks with nodes are *units*, numbered robot by robot. A relation holds for the nodes as they are;
only the order of the robots' tasks among each other is left open. Each is searched when it is
first asked for, and remembered.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from itertools import chain as joined

import numpy as np

from planning.transforms import Indices
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.conflicts.object_spans import Node, handlings_in_order
from scheduling.conflicts.occupancy import Occupancy
from scheduling.graph.task_edges import dependency_edges, task_nodes
from scheduling.ordering.contents import Contents, KnownConflicts, Stair

_Key = tuple[object, ...]
"""Cache key of an obstacle."""


class TaskRelations:
    """Relations between the tasks of a graph.

    Args:
        graph: its edges are not looked at.
        known: what was found for other graphs of the same cell; what is found here is added.

    Attributes:
        graph: the graph.
        units: all units.
        of_chain: units of each chain, in order.
        before: units of other robots that must be complete before each unit.
        left_by, taken_by: numbers of the rests that begin in a unit, and that end in one.
    """

    def __init__(self, graph: DerivedTpg, known: KnownConflicts | None = None) -> None:
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
        self._occupancies: dict[_Key, Occupancy] = {}
        self._stairs: dict[tuple[int, int], Stair | None] = {}
        self._clear: dict[tuple[_Key, int], bool] = {}
        self._known = known
        self._contents = Contents(graph, self.units)

    def unit_of(self, node: Node) -> int:
        """Return the unit that a node (chain, index) belongs to."""
        chain, index = node
        place = int(np.searchsorted(self._first[chain], index, side="right")) - 1
        return self.of_chain[chain][place]

    def stairs(self, earlier: int, later: int) -> Stair | None:
        """Return the nodes of a unit that wait for another robot's, and for which; None for none.

        Each node of the later unit waits for the last node of the earlier one that it conflicts
        with; what follows from the stairs below is left out.
        """
        key = (earlier, later)
        if key not in self._stairs:
            if self._known is None:
                self._stairs[key] = self._find_stairs(earlier, later)
            else:
                pair = self._contents.pair(("unit", earlier), later)
                if pair not in self._known.stairs:
                    self._known.stairs[pair] = self._find_stairs(earlier, later)
                self._stairs[key] = self._known.stairs[pair]
        return self._stairs[key]

    def _find_stairs(self, earlier: int, later: int) -> Stair | None:
        a, b = self._unit(later), self._unit(earlier)
        stairs: list[tuple[int, int]] = []
        for v, u in sorted(self.graph.conflicts(a, b, *_all_nodes(a, b))):
            if not stairs or u > stairs[-1][1]:
                stairs.append((v, u))
        rows = np.array(stairs, dtype=np.int64).reshape(-1, 2)
        return (rows[:, 0], rows[:, 1]) if stairs else None

    def sweeps_clear(self, first: int, second: int) -> bool:
        """Tell whether two units of different robots keep clear at any times."""
        a, b = sorted((first, second))
        return self._clear_of(("unit", a), lambda: self._unit(a), b)

    def stands_clear(self, chain: int, done: int, unit: int) -> bool:
        """Tell whether a unit keeps clear of a robot that has done its first ``done`` units."""
        own = self.of_chain[chain]
        hold = self.units[own[done - 1]].stop if done else 0
        return self._clear_of(
            ("hold", chain, hold),
            lambda: self.graph.holds(chain, np.array([hold])),
            unit,
        )

    def idle_clear(self, robot: str, unit: int) -> bool:
        """Tell whether a unit keeps clear of a robot without nodes."""
        placed = self.graph.tpg.cell.robot(robot)
        return self._clear_of(
            ("idle", robot), lambda: self.graph.standing(placed), unit
        )

    def rest_clear(self, number: int, unit: int) -> bool:
        """Tell whether a unit keeps clear of an object at rest."""
        rest = self.graph.history.rests[number]
        return self._clear_of(("rest", number), lambda: self.graph.rest(rest), unit)

    def _unit(self, unit: int) -> Occupancy:
        """Return what a unit occupies, its nodes counted from its first one."""
        u = self.units[unit]
        return self._kept(
            ("unit", unit), lambda: self.graph.occupancy(u.chain, u.first, u.stop)
        )

    def _kept(self, key: _Key, make: Callable[[], Occupancy]) -> Occupancy:
        if key not in self._occupancies:
            self._occupancies[key] = make()
        return self._occupancies[key]

    def _clear_of(self, key: _Key, make: Callable[[], Occupancy], unit: int) -> bool:
        """Tell whether a unit keeps clear of what the key stands for, which is made if need be."""
        if (key, unit) not in self._clear:
            self._clear[key, unit] = self._find_clear(key, make, unit)
        return self._clear[key, unit]

    def _find_clear(self, key: _Key, make: Callable[[], Occupancy], unit: int) -> bool:
        pair = None
        if self._known is not None:
            pair = self._contents.pair(key, unit)
            if pair in self._known.clear:
                return self._known.clear[pair]
        a, b = self._kept(key, make), self._unit(unit)
        clear = self.graph.first_conflict(a, b, *_all_nodes(a, b)) is None
        if self._known is not None and pair is not None:
            self._known.clear[pair] = clear
        return clear

    def _prerequisites(self) -> list[set[int]]:
        """Return what tasks depend on, and who had each object before."""
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


def _all_nodes(a: Occupancy, b: Occupancy) -> tuple[Indices, Indices]:
    """Return the window of a search, see ``search_conflicts``, that leaves nothing out."""
    floor = np.full(a.nodes, -1, dtype=np.int64)
    return floor, np.full(a.nodes, b.nodes, dtype=np.int64)
