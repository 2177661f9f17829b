"""Conflicts and dependencies between pairs of tasks, whichever of the two comes first.

Tasks with nodes are *units*, numbered robot by robot. A relation holds for the nodes as they are;
only the order of the robots' tasks among each other is left open. Each is searched when it is
first asked for, and remembered.

What tasks, stands and objects at rest consist of, and what is known of how they get on.

Whether two of them conflict depends on what they sweep and who may touch whom in both, not on the
graph that they are part of. So what was found for one graph holds in another one of the same cell.

Edges of a graph whose tasks are in a given order, from what is known of pairs of tasks.
"""

from __future__ import annotations

import hashlib
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain as joined

import numpy as np

from planning.transforms import Indices
from scheduling.build_tpg import connect_nodes
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.conflicts.object_spans import Node, handlings_in_order
from scheduling.conflicts.occupancy import Occupancy
from scheduling.graph.task_edges import TaskNodes, dependency_edges, task_nodes
from scheduling.graph.temporal_plan_graph import (
    MOTION_CONFLICT,
    TASK_DEPENDENCY,
    NodeChain,
    TemporalPlanGraph,
)

Stair = tuple[Indices, Indices]
"""Nodes of the later task, counted from its first one, and for each the node of the earlier
task that must be complete before it."""

Pair = tuple[bytes, bytes, frozenset[tuple[str, str]]]
"""What two things consist of, and who may touch whom in both."""

_KEPT_PAIRS = 200_000
"""Pairs that are kept."""


@dataclass
class KnownConflicts:
    """Conflicts found for pairs of things, whichever graph they were in.

    Attributes:
        stairs: see ``TaskRelations.stairs``.
        clear: whether the two keep clear of each other.
    """

    stairs: dict[Pair, Stair | None] = field(default_factory=dict)
    clear: dict[Pair, bool] = field(default_factory=dict)

    def make_room(self) -> None:
        """Forget all where it is too much to keep; not while a graph is looked at."""
        if len(self.stairs) + len(self.clear) > _KEPT_PAIRS:
            self.stairs.clear()
            self.clear.clear()


class Contents:
    """Digests of the things of a graph, each made when it is first asked for.

    A thing is ("unit", number), ("hold", chain, node behind it), ("idle", robot) or ("rest", number).

    Args:
        graph: the graph.
        units: its tasks with nodes.
    """

    def __init__(self, graph: DerivedTpg, units: Sequence[TaskNodes]) -> None:
        self._graph, self._units = graph, units
        self._digests: dict[tuple[object, ...], bytes] = {}
        self._listed: dict[int, set[int]] | None = None

    def pair(self, thing: tuple[object, ...], unit: int) -> Pair:
        """Return what decides how a thing and a unit get on."""
        both = self._contacts(thing)
        own = self._contacts(("unit", unit)) or set()
        allowed = self._graph.tpg.allowed
        entries = own if both is None else both & own
        names = frozenset((allowed[k].first, allowed[k].second) for k in entries)
        return self._digest(thing), self._digest(("unit", unit)), names

    def _contacts(self, thing: tuple[object, ...]) -> set[int] | None:
        """Return the allowed contacts of the tasks of a thing, None for all of them."""
        if thing[0] in ("idle", "rest"):
            return None
        if self._listed is None:
            self._listed = defaultdict(set)
            for k, contact in enumerate(self._graph.tpg.allowed):
                for task in contact.tasks:
                    self._listed[task].add(k)
        if thing[0] == "unit":
            return self._listed[self._units[_number(thing[1])].task]
        chain, hold = _number(thing[1]), _number(thing[2])
        tasks = self._graph.tpg.chains[chain].task
        last = len(tasks) - 1
        before, after = tasks[max(hold - 1, 0)], tasks[min(hold, last)]
        return self._listed[int(before)] | self._listed[int(after)]

    def _digest(self, thing: tuple[object, ...]) -> bytes:
        if thing not in self._digests:
            digest = hashlib.blake2b(repr(thing[0]).encode(), digest_size=16)
            for part in self._parts(thing):
                digest.update(part)
            self._digests[thing] = digest.digest()
        return self._digests[thing]

    def _parts(self, thing: tuple[object, ...]) -> list[bytes]:
        graph = self._graph
        if thing[0] == "idle":
            return [str(thing[1]).encode()]
        if thing[0] == "rest":
            rest = graph.history.rests[_number(thing[1])]
            return [rest.object.encode(), rest.pose.tobytes()]
        if thing[0] == "hold":
            index, hold = _number(thing[1]), _number(thing[2])
            chain = graph.tpg.chains[index]
            at = int(chain.first[hold]) - 1
            q = chain.start if at < 0 else chain.waypoints[at]
            held = [
                part
                for span in graph.spans[index]
                if span.carried and span.start[0] < hold <= span.end[0]
                for part in (span.object.encode(), span.pose.tobytes())
            ]
            return [chain.robot.encode(), q.tobytes(), *held]
        unit = self._units[_number(thing[1])]
        nodes = graph.tpg.chains[unit.chain].cut(unit.first, unit.stop)
        parts = [
            nodes.robot.encode(),
            nodes.start.tobytes(),
            nodes.waypoints.tobytes(),
            nodes.first.tobytes(),
        ]
        for span in graph.spans[unit.chain]:
            if span.start[0] < unit.stop and span.end >= (unit.first, 0):
                first = max(span.start, (unit.first, 0))
                last = min(span.end, (unit.stop, 0))
                when = (first[0] - unit.first, first[1], last[0] - unit.first, last[1])
                parts += [repr((span.object, when, span.carried)).encode()]
                parts += [span.pose.tobytes()]
        return parts


def _number(value: object) -> int:
    assert isinstance(value, int)
    return value


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
