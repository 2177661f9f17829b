"""Conflicts and dependencies between pairs of tasks, whichever of the two comes first.

Tasks with nodes are *units*, numbered robot by robot. A relation holds for the nodes as they are;
only the order of the robots' tasks among each other is left open. Each is searched when it is
first asked for, and remembered.

Edges of a graph whose tasks are in a given order, from what is known of pairs of tasks.

Robots planned as one beside skills: clear of all that these sweep, whenever they are done.

A skill follows its reference path and takes a time that nobody knows before, so there is no lock
step with it. What a motion and a skill occupy is compared as in the search for conflicts, which
therefore finds none between them later.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from itertools import chain as joined

import numpy as np

from planning.motion.composite import CompositeChecker
from planning.motion.known_motions import TaskMotion
from planning.motion.sequential import MARGIN
from planning.transforms import Array, Indices
from scheduling.build_tpg import connect_nodes
from scheduling.conflicts.close_bodies import contact_table
from scheduling.conflicts.conflict_search import first_conflict
from scheduling.conflicts.derived_tpg import (
    DerivedTpg,
    GraphStretch,
    StretchConflicts,
    Window,
    holds_stretch,
    nodes_stretch,
    rest_stretch,
    standing_stretch,
)
from scheduling.conflicts.object_spans import Node, ObjectSpan, handlings_in_order
from scheduling.conflicts.occupancy import chain_occupancy
from scheduling.graph.task_edges import TaskNodes, dependency_edges, task_nodes
from scheduling.graph.temporal_plan_graph import (
    MOTION_CONFLICT,
    TASK_DEPENDENCY,
    NodeChain,
    TemporalPlanGraph,
    pose_nodes,
)

Stair = tuple[Indices, Indices]
"""Nodes of the later task, counted from its first one, and for each the node of the earlier
task that must be complete before it."""

_Key = tuple[object, ...]
"""Names a unit, a stand, a robot without nodes or an object at rest."""


class TaskRelations:
    """Relations between the tasks of a graph.

    Args:
        graph: its edges are not looked at.
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
        self, graph: DerivedTpg, conflicts: StretchConflicts | None = None
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
        self._conflicts = conflicts or StretchConflicts()
        self._things: dict[_Key, GraphStretch] = {}
        self._stairs: dict[tuple[int, int], Stair | None] = {}
        self._clear: dict[tuple[_Key, int], bool] = {}

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
        if (earlier, later) not in self._stairs:
            a, b = self.stretch(later), self.stretch(earlier)
            found = self._conflicts.search(self.graph, a, b, _all_nodes(a, b))
            stairs: list[tuple[int, int]] = []
            for v, u in sorted(found):
                if not stairs or u > stairs[-1][1]:
                    stairs.append((v, u))
            rows = np.array(stairs, dtype=np.int64).reshape(-1, 2)
            self._stairs[earlier, later] = (rows[:, 0], rows[:, 1]) if stairs else None
        return self._stairs[earlier, later]

    def sweeps_clear(self, first: int, second: int) -> bool:
        """Tell whether two units of different robots keep clear at any times."""
        a, b = sorted((first, second))
        return self._clear_of(("unit", a), lambda: self.stretch(a), b)

    def stands_clear(self, chain: int, done: int, unit: int) -> bool:
        """Tell whether a unit keeps clear of a robot that has done its first ``done`` units."""
        own = self.of_chain[chain]
        hold = self.units[own[done - 1]].stop if done else 0
        return self._clear_of(
            ("hold", chain, hold),
            lambda: holds_stretch(self.graph, chain, np.array([hold])),
            unit,
        )

    def idle_clear(self, robot: str, unit: int) -> bool:
        """Tell whether a unit keeps clear of a robot without nodes."""
        placed = self.graph.tpg.cell.robot(robot)
        return self._clear_of(
            ("idle", robot), lambda: standing_stretch(self.graph, placed), unit
        )

    def rest_clear(self, number: int, unit: int) -> bool:
        """Tell whether a unit keeps clear of an object at rest."""
        rest = self.graph.history.rests[number]
        return self._clear_of(
            ("rest", number), lambda: rest_stretch(self.graph, rest), unit
        )

    def stretch(self, unit: int) -> GraphStretch:
        """Return a unit as a stretch, its nodes counted from its first one."""
        u = self.units[unit]
        return self._thing(
            ("unit", unit), lambda: nodes_stretch(self.graph, u.chain, u.first, u.stop)
        )

    def _thing(self, key: _Key, make: Callable[[], GraphStretch]) -> GraphStretch:
        if key not in self._things:
            self._things[key] = make()
        return self._things[key]

    def _clear_of(self, key: _Key, make: Callable[[], GraphStretch], unit: int) -> bool:
        """Tell whether a unit keeps clear of what the key stands for, which is made if need be."""
        if (key, unit) not in self._clear:
            a, b = self._thing(key, make), self.stretch(unit)
            clear = self._conflicts.are_clear(self.graph, a, b, _all_nodes(a, b))
            self._clear[key, unit] = clear
        return self._clear[key, unit]

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


def _all_nodes(a: GraphStretch, b: GraphStretch) -> Window:
    """Return the window of a search that leaves nothing out."""
    floor = np.full(a.nodes, -1, dtype=np.int64)
    return floor, np.full(a.nodes, b.nodes, dtype=np.int64)


def connect_in_order(
    chains: Sequence[NodeChain],
    relations: TaskRelations,
    order: Sequence[tuple[int, ...]],
) -> TemporalPlanGraph:
    """Return the graph that ``connect_nodes`` makes of some chains, without checking it.

    Args:
        chains: with planned starts in that order, see ``put_in_order``.
        relations: of their units.
        order: blocks of units, one after another.

    Raises:
        PlanInvariantError: units that move at once get into each other's way.
    """
    tpg = replace(relations.graph.tpg, chains=tuple(chains))
    if any(len(block) > 1 for block in order):
        return connect_nodes(DerivedTpg(tpg))
    tasks = dependency_edges(tpg)
    motions = _motion_edges(relations, tasks, [block[0] for block in order])
    causes = np.array([TASK_DEPENDENCY, MOTION_CONFLICT], dtype=np.uint8)
    edges = np.concatenate([tasks, motions])
    cause = np.repeat(causes, [len(tasks), len(motions)])
    return DerivedTpg(tpg).with_edges(edges, cause).tpg


def _motion_edges(
    relations: TaskRelations, tasks: Indices, order: Sequence[int]
) -> Indices:
    """Return edges that imply all that conflicts of units ask for, given those of tasks."""
    units, chains = relations.units, range(len(relations.of_chain))
    needs: dict[int, list[int]] = defaultdict(list)
    for i, u, k, v in tasks.tolist():
        needs[relations.unit_of((k, v))].append(relations.unit_of((i, u)))
    edges: list[tuple[int, int, int, int]] = []
    # How many units of each chain are known to be complete before each unit starts.
    complete: dict[int, list[int]] = {}
    done = [0 for _ in chains]
    last: dict[int, int] = {}

    def follow(known: list[int], unit: int) -> None:
        for chain, count in enumerate(complete[unit]):
            known[chain] = max(known[chain], count)
        chain, place = units[unit].chain, units[unit].place
        known[chain] = max(known[chain], place + 1)

    for unit in order:
        own, known = units[unit], [0 for _ in chains]
        for earlier in [
            *needs[unit],
            *([last[own.chain]] if own.chain in last else []),
        ]:
            follow(known, earlier)
        for chain in chains:
            if chain == own.chain:
                continue
            for place in range(done[chain] - 1, -1, -1):
                if place < known[chain]:
                    break
                other = relations.of_chain[chain][place]
                stairs = relations.stairs(other, unit)
                if stairs is None:
                    continue
                u = units[other]
                nodes, after = stairs
                edges += [
                    (chain, u.first + a, own.chain, own.first + b)
                    for b, a in zip(nodes.tolist(), after.tolist(), strict=True)
                ]
                if nodes[0] == 0 and u.first + after[0] == u.stop - 1:
                    follow(known, other)
        complete[unit], last[own.chain] = known, unit
        done[own.chain] += 1
    return np.array(edges, dtype=np.int64).reshape(-1, 4)


class BesideSkills:
    """Collision checks of robots that move as one while others do skills.

    Args:
        checker: of the robots that move, without those that do skills.
        graph: of the sequential plan.
        transits: the nodes of each moving robot's task there; what it carries follows from them.
        skills: what is done meanwhile.
    """

    def __init__(
        self,
        checker: CompositeChecker,
        graph: DerivedTpg,
        transits: Mapping[str, TaskNodes],
        skills: Sequence[GraphStretch],
    ) -> None:
        self.speed = checker.speed
        self._checker, self._graph, self._transits = checker, graph, transits
        self._skills = skills
        cell = graph.tpg.cell
        wider = replace(
            cell.clearances,
            robot_robot=cell.clearances.robot_robot + MARGIN,
            robot_object=cell.clearances.robot_object + MARGIN,
        )
        self._table = contact_table(
            graph.entities, len(cell.robots), graph.tpg.allowed, wider
        )
        self._held = {name: _in_hand(graph, nodes) for name, nodes in transits.items()}

    def configuration_free(self, q: Array) -> bool:
        """Tell whether all robots may stand at composite ``q`` during the skills, shape (n,)."""
        return self._checker.configuration_free(q) and self._clear(q, q)

    def motion_free(self, q_a: Array, q_b: Array) -> bool:
        """Tell whether the composite line from ``q_a`` to ``q_b`` is free, shape (n,)."""
        return self._checker.motion_free(q_a, q_b) and self._clear(q_a, q_b)

    def seems_free(self, q_a: Array, q_b: Array) -> bool:
        """Tell whether some configurations of the line are free, and all of it of the skills."""
        return self._checker.seems_free(q_a, q_b) and self._clear(q_a, q_b)

    def motions(self, path: Array) -> dict[str, TaskMotion] | None:
        """Return the motion of each robot on a composite polyline; see ``CompositeChecker``."""
        found = self._checker.motions(path)
        if found is None or not all(
            self._clear_of_skills(name, motion.path) for name, motion in found.items()
        ):
            return None
        return found

    def _clear(self, q_a: Array, q_b: Array) -> bool:
        return all(
            self._clear_of_skills(name, np.stack([q_a[own], q_b[own]]))
            for name, own in zip(
                self._checker.robots, self._checker.joints, strict=True
            )
        )

    def _clear_of_skills(self, robot: str, path: Array) -> bool:
        """Tell whether a robot on a polyline, shape (w, n), is clear of what the skills sweep."""
        path = path if len(path) > 1 else np.repeat(path, 2, axis=0)
        count = len(path) - 1
        task = self._transits[robot].task
        nodes = pose_nodes(robot, path[0], path[1:], task, 0.0)
        held = [replace(span, end=(count, 0)) for span in self._held[robot]]
        own = chain_occupancy(self._graph.tpg.cell, nodes, held, self._graph.entities)
        floor = np.full(count, -1, dtype=np.int64)
        return all(
            first_conflict(
                own, skill.occupancy, floor, np.full(count, skill.nodes), self._table
            )
            is None
            for skill in self._skills
        )


def _in_hand(graph: DerivedTpg, nodes: TaskNodes) -> list[ObjectSpan]:
    """Return what a robot carries all through a transit, as spans from its first node on."""
    return [
        replace(span, start=(0, 0))
        for span in graph.spans[nodes.chain]
        if span.carried and span.start <= (nodes.first, 0) < span.end
    ]
