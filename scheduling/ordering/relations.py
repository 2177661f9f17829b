"""What two tasks are to each other, whichever of them comes first: asked for, found, remembered.

Tasks with nodes are *units*, numbered robot by robot. A relation holds for the nodes as they are;
only the order of the robots' tasks among each other is left open.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from planning.transforms import Indices
from scheduling.build_tpg import dependency_edges
from scheduling.conflicts.allowed_contacts import EntityNumbers, contact_table
from scheduling.conflicts.conflict_search import HullChecker, search_conflicts
from scheduling.conflicts.kept_occupancies import cut_chain, occupancy_of
from scheduling.conflicts.object_spans import Node, Rest, trace_objects
from scheduling.conflicts.occupancy import Occupancy, hold_occupancy, rest_occupancy
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph

Stair = tuple[Indices, Indices]
"""Nodes of the later task, counted from its first one, and for each the node of the earlier
task that must be complete before it."""


@dataclass(frozen=True)
class Unit:
    """A task that has nodes.

    Attributes:
        task: its index.
        chain: of its robot.
        first, stop: its nodes are ``range(first, stop)``.
        place: how many units its robot has before it.
    """

    task: int
    chain: int
    first: int
    stop: int
    place: int


class TaskRelations:
    """Relations between the tasks of a graph.

    Args:
        tpg: the graph.
        ranks: place of every node in the total order.
        entities: numbers of the entities.

    Attributes:
        units: all of them.
        of_chain: units of each chain, in order.
        before: units of other robots that must be complete before each unit.
    """

    def __init__(
        self,
        tpg: TemporalPlanGraph,
        ranks: Sequence[Indices],
        entities: EntityNumbers,
    ) -> None:
        self._tpg = tpg
        self._entities = entities
        self._table = contact_table(self._entities, tpg.allowed, tpg.cell.clearances)
        self._checker = HullChecker(self._table)
        self._history = trace_objects(tpg, ranks)
        self.units: list[Unit] = []
        self.of_chain: list[list[int]] = []
        for index, chain in enumerate(tpg.chains):
            tasks, first = np.unique(chain.task, return_index=True)
            stops = [*first[1:].tolist(), len(chain)]
            own = []
            for task, a, b in zip(tasks.tolist(), first.tolist(), stops, strict=True):
                own.append(len(self.units))
                self.units.append(Unit(task, index, a, b, len(own) - 1))
            self.of_chain.append(own)
        self._first = [[self.units[u].first for u in own] for own in self.of_chain]
        self.before = self._prerequisites(ranks)
        self.left_by: dict[int, list[int]] = defaultdict(list)
        self.taken_by: dict[int, list[int]] = defaultdict(list)
        for number, rest in enumerate(self._history.rests):
            if rest.after is not None:
                self.left_by[self.unit_of(rest.after)].append(number)
            if rest.before is not None:
                self.taken_by[self.unit_of(rest.before)].append(number)
        self._spans = [
            [span for span in self._history.spans if span.robot == chain]
            for chain in range(len(tpg.chains))
        ]
        self._occupancies: list[Occupancy | None] = [None] * len(self.units)
        self._stairs: dict[tuple[int, int], Stair | None] = {}
        self._clear: dict[tuple[int, int, int], bool] = {}
        self._rests: dict[int, Occupancy] = {}

    def unit_of(self, node: Node) -> int:
        """Return the unit that a node (chain, index) belongs to."""
        chain, index = node
        place = int(np.searchsorted(self._first[chain], index, side="right")) - 1
        return self.of_chain[chain][place]

    def rest(self, number: int) -> Rest:
        """Return where an object lies between two units."""
        return self._history.rests[number]

    def _prerequisites(self, ranks: Sequence[Indices]) -> list[set[int]]:
        """Return what tasks depend on, and who had each object before."""
        tpg, before = self._tpg, [set[int]() for _ in self.units]
        edges = dependency_edges(tpg.tasks, tpg.dependencies, tpg.chains)
        for i, u, k, v in edges.tolist():
            before[self.unit_of((k, v))].add(self.unit_of((i, u)))
        last: dict[str, int] = {}
        for handling in sorted(
            tpg.handlings, key=lambda h: (ranks[h.robot][h.node], h.waypoint)
        ):
            unit = self.unit_of((handling.robot, handling.node))
            previous = last.get(handling.object, unit)
            if self.units[previous].chain != self.units[unit].chain:
                before[unit].add(previous)
            last[handling.object] = unit
        for rest in self._history.rests:
            # The standing robot that takes an object in its hand must have come to stand.
            for a, b in ((rest.stood, rest.after), (rest.after, rest.before)):
                if a is not None and b is not None and a[0] != b[0]:
                    before[self.unit_of(b)].add(self.unit_of(a))
        return before

    def stairs(self, earlier: int, later: int) -> Stair | None:
        """Return which nodes of a unit wait for which of another robot's; None for none.

        Each node of the later unit waits for the last node of the earlier one that it conflicts
        with; what follows from the stairs below is left out.
        """
        key = (earlier, later)
        if key not in self._stairs:
            found = self._search(self._occupancy(later), earlier, until_none=True)
            stairs: list[tuple[int, int]] = []
            for v, u in sorted(found):
                if not stairs or u > stairs[-1][1]:
                    stairs.append((v, u))
            rows = np.array(stairs, dtype=np.int64).reshape(-1, 2)
            self._stairs[key] = (rows[:, 0], rows[:, 1]) if stairs else None
        return self._stairs[key]

    def stands_clear(self, chain: int, done: int, unit: int) -> bool:
        """Tell whether a unit keeps clear of a robot that has done its first ``done`` units."""
        key = (chain, done, unit)
        if key not in self._clear:
            own = self.of_chain[chain]
            hold = self.units[own[done - 1]].stop if done else 0
            self._clear[key] = not self._search(self._standing(chain, hold), unit)
        return self._clear[key]

    def rest_clear(self, number: int, unit: int) -> bool:
        """Tell whether a unit keeps clear of an object at rest."""
        key = (-1, number, unit)
        if key not in self._clear:
            if number not in self._rests:
                self._rests[number] = rest_occupancy(
                    self._tpg, self.rest(number), self._entities
                )
            self._clear[key] = not self._search(self._rests[number], unit)
        return self._clear[key]

    def _occupancy(self, unit: int) -> Occupancy:
        """Return what a unit occupies, its nodes counted from its first one."""
        known = self._occupancies[unit]
        if known is None:
            u = self.units[unit]
            nodes = cut_chain(self._tpg.chains[u.chain], u.first, u.stop)
            known = occupancy_of(
                self._tpg,
                u.chain,
                nodes,
                u.first,
                u.stop - u.first,
                self._spans[u.chain],
                self._entities,
            )
            self._occupancies[unit] = known
        return known

    def _standing(self, chain: int, hold: int) -> Occupancy:
        """Return what a robot occupies that stands before a node."""
        nodes = self._tpg.chains[chain]
        lo, hi = max(hold - 1, 0), min(hold + 1, len(nodes))
        held = [
            replace(
                span,
                start=(span.start[0] - lo, span.start[1]),
                end=(span.end[0] - lo, span.end[1]),
            )
            for span in self._spans[chain]
            if span.start[0] < hi and span.end[0] >= lo
        ]
        chains = list(self._tpg.chains)
        chains[chain] = cut_chain(nodes, lo, hi)
        around = replace(self._tpg, chains=tuple(chains))
        return hold_occupancy(
            around, chain, np.array([hold - lo]), held, self._entities
        )

    def _search(
        self, occupancy: Occupancy, unit: int, *, until_none: bool = False
    ) -> list[tuple[int, int]]:
        """Return conflicts of an occupancy with a unit: the first, or until all are implied."""
        other = self._occupancy(unit)
        count = int(occupancy.sequence.node[-1]) + 1
        size = int(other.sequence.node[-1]) + 1
        found = search_conflicts(
            occupancy,
            other,
            np.full(count, -1, dtype=np.int64),
            np.full(count, size, dtype=np.int64),
            self._table,
            self._checker,
        )
        if until_none:
            return list(found)
        conflict = next(found, None)
        return [] if conflict is None else [conflict]
