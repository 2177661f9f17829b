"""A temporal plan graph with cached derived data: its occupancies and the conflicts between them.

``DerivedTpg`` caches the order of the nodes, the allowed contacts, the locations of objects over time, and all
occupancies. It is used wherever edges are added, verified or changed.

An ``Occupant`` takes up space: some nodes of a robot, a robot at rest between two nodes, or an object at rest.
Whether two occupants conflict depends on their geometry and their allowed contacts, not on the edges.
"""

from __future__ import annotations

import hashlib
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from planning.caches import BoundedCache
from planning.cell.workcell import PlacedRobot, PoseError
from planning.geometry.robot_bodies import entity_numbers
from planning.parallel import map_in_parallel
from planning.tasks.task import AllowedContact
from planning.transforms import Indices
from scheduling.conflicts.allowed_contacts import ContactTable, contact_table
from scheduling.conflicts.conflict_search import first_conflict, search_conflicts
from scheduling.conflicts.object_spans import (
    Moment,
    ObjectHistory,
    ObjectSpan,
    Rest,
    trace_objects,
)
from scheduling.conflicts.occupancy import (
    Occupancy,
    chain_occupancy,
    hold_occupancy,
    rest_occupancy,
    standing_occupancy,
)
from scheduling.graph.rollout import Rollout, earliest_times
from scheduling.graph.temporal_plan_graph import Causes, NodeChain, TemporalPlanGraph
from scheduling.graph.total_order import (
    FlatGraph,
    NodeOrder,
    flatten_graph,
    planned_ranks,
    transitive_reduction,
)

_MOST_CACHED = 100_000
"""Most results of conflict searches that are cached."""

Window = tuple[Indices, Indices]
"""Nodes of a query: above the floor and below the limit, see ``search_conflicts``."""


@dataclass(frozen=True, eq=False)
class DerivedTpg:
    """A graph with derived data, computed on first use.

    Attributes:
        tpg: the graph.
    """

    tpg: TemporalPlanGraph

    @cached_property
    def ranks(self) -> tuple[Indices, ...]:
        """Position of every node in the total order, one array a chain."""
        return planned_ranks(self.tpg.chains)

    @cached_property
    def flat(self) -> FlatGraph:
        """Nodes and edges as flat arrays."""
        return flatten_graph(self.ranks, self.tpg.edges)

    @cached_property
    def order(self) -> NodeOrder:
        """Precedence between nodes that type-1 and type-2 edges impose."""
        return transitive_reduction(self.ranks, self.tpg.edges)[0]

    @cached_property
    def entities(self) -> dict[str, int]:
        """Entity numbers of the robots' arms and tools and of the handled objects."""
        handled = dict.fromkeys(handling.object for handling in self.tpg.handlings)
        return entity_numbers((robot.name for robot in self.tpg.cell.robots), handled)

    @cached_property
    def table(self) -> ContactTable:
        """Allowed contacts and clearances."""
        cell = self.tpg.cell
        return contact_table(
            self.entities, len(cell.robots), self.tpg.allowed, cell.clearances
        )

    @cached_property
    def history(self) -> ObjectHistory:
        """History of every handled object."""
        return trace_objects(self.tpg, self.ranks)

    @cached_property
    def spans(self) -> tuple[tuple[ObjectSpan, ...], ...]:
        """The objects in each chain's occupancy."""
        return tuple(
            tuple(span for span in self.history.spans if span.robot == chain)
            for chain in range(len(self.tpg.chains))
        )

    @cached_property
    def deviations(self) -> dict[int, PoseError]:
        """Allowed deviation of the flange from the path, for each task whose skill states one."""
        known = self.tpg.cell.deviations
        return {t.index: known[t.kind] for t in self.tpg.tasks if known.get(t.kind)}

    @cached_property
    def occupancies(self) -> list[Occupancy]:
        """Occupancy of the nodes of each chain."""
        cell, entities, spans = self.tpg.cell, self.entities, self.spans
        return map_in_parallel(
            lambda k: chain_occupancy(
                cell, self.tpg.chains[k], spans[k], entities, self.deviations
            ),
            range(len(self.tpg.chains)),
        )

    @cached_property
    def rollout(self) -> Rollout:
        """Start and end of every node at nominal durations [s]."""
        return earliest_times(self.tpg, flat=self.flat)

    def spans_within(self, chain: int, first: int, stop: int) -> list[ObjectSpan]:
        """Return the objects in the occupancy of some nodes of a chain, numbered from 0.

        Args:
            chain: the chain.
            first, stop: its nodes ``range(first, stop)``.
        """

        def clip(moment: Moment) -> Moment:
            node, waypoint = min(max(moment, (first, 0)), (stop, 0))
            return node - first, waypoint

        return [
            replace(span, start=clip(span.start), end=clip(span.end))
            for span in self.spans[chain]
            if span.start[0] < stop and span.end >= (first, 0)
        ]

    def with_edges(self, edges: Indices, cause: Causes) -> DerivedTpg:
        """Return the graph with other edges, reduced and sorted.

        Args:
            edges: type-2 edges, shape (e, 4).
            cause: of each, shape (e,).

        Raises:
            PlanInvariantError: an edge goes against the total order.
        """
        order, keep = transitive_reduction(self.ranks, edges)
        edges, cause = edges[keep], cause[keep]
        by_edge = np.lexsort(edges.T[::-1])
        tpg = replace(self.tpg, edges=edges[by_edge], cause=cause[by_edge])
        same = ("ranks", "history", "spans", "occupancies")
        return self.derive(tpg, *same, order=order)

    def derive(self, tpg: TemporalPlanGraph, *same: str, **known: Any) -> DerivedTpg:
        """Return another graph of the same cell, objects and contacts.

        Args:
            tpg: the graph.
            same: attributes that are the same for both.
            known: attributes of the other graph to reuse.
        """
        other = DerivedTpg(tpg)
        kept = {"entities", "table", *same} & vars(self).keys()
        vars(other).update({name: vars(self)[name] for name in kept}, **known)
        return other

    def node_name(self, chain: int, node: int) -> str:
        """Return the name of a node in messages."""
        own = self.tpg.chains[chain]
        task = int(own.task[node])
        label = next((t.label for t in self.tpg.tasks if t.index == task), "")
        return f"node {node} of robot {own.robot!r} (task {task}, {label})"


@dataclass
class Occupant:
    """Something that takes up space: nodes or holds of a robot, or an object at rest.

    Attributes:
        nodes: number of nodes or holds, 1 for an object at rest.
        tasks: that its nodes belong to, in order; None for an object at rest, to which contacts of all tasks apply.
        parts: returns its content except its tasks, as bytes.
        make: returns its occupancy.
    """

    nodes: int
    tasks: tuple[int, ...] | None
    parts: Callable[[], Iterable[bytes]]
    make: Callable[[], Occupancy]

    @cached_property
    def occupancy(self) -> Occupancy:
        """Its occupancy, computed on first use."""
        return self.make()

    @cached_property
    def content(self) -> bytes:
        """Digest of its content."""
        digest = hashlib.blake2b(digest_size=16)
        for part in self.parts():
            digest.update(part)
        return digest.digest()


def occupant_of_nodes(
    graph: DerivedTpg,
    chain: int,
    first: int,
    stop: int,
    nodes: NodeChain | None = None,
) -> Occupant:
    """Return some nodes of a chain as an occupant, numbered from 0.

    Args:
        graph: the graph.
        chain: the chain.
        first, stop: its nodes ``range(first, stop)``.
        nodes: other nodes in their place, which carry the same objects.
    """
    own = nodes or graph.tpg.chains[chain].cut(first, stop)
    tasks = tuple(dict.fromkeys(own.task.tolist()))

    spans = graph.spans_within(chain, first, stop)
    # No reference to the graph: an occupant outlives it, and every change makes another graph.
    cell, entities, off = graph.tpg.cell, graph.entities, graph.deviations

    def parts() -> Iterable[bytes]:
        yield repr((own.robot, len(own), len(own.waypoints))).encode()
        yield own.start.tobytes()
        yield own.waypoints.tobytes()
        yield own.first.tobytes()
        yield (own.task[1:] != own.task[:-1]).tobytes()
        for span in spans:
            yield repr((span.object, span.start, span.end, span.carried)).encode()
            yield span.pose.tobytes()
        if off:
            yield own.skill.tobytes()
            yield repr([off.get(task) for task in tasks]).encode()

    def make() -> Occupancy:
        return chain_occupancy(cell, own, spans, entities, off)

    return Occupant(len(own), tasks, parts, make)


def occupant_of_holds(graph: DerivedTpg, chain: int, holds: Indices) -> Occupant:
    """Return some holds of a robot as an occupant, see ``hold_occupancy``."""
    nodes, last = graph.tpg.chains[chain], len(graph.tpg.chains[chain]) - 1
    adjacent = np.clip(np.stack([holds - 1, holds], axis=1), 0, last)
    around = nodes.task[adjacent].ravel().tolist()
    tasks = tuple(dict.fromkeys(around))

    def parts() -> Iterable[bytes]:
        yield repr(("holds", nodes.robot, len(holds))).encode()
        before = nodes.waypoints[nodes.first[holds] - 1]
        yield np.where((holds > 0)[:, None], before, nodes.start).tobytes()
        yield repr([tasks.index(task) for task in around]).encode()
        for span in graph.spans[chain]:
            if span.carried:
                inside = (holds > span.start[0]) & (holds <= span.end[0])
                if np.any(inside):
                    yield span.object.encode()
                    yield inside.tobytes() + span.pose.tobytes()

    def make() -> Occupancy:
        cell, spans = graph.tpg.cell, graph.spans[chain]
        return hold_occupancy(cell, nodes, holds, spans, graph.entities)

    return Occupant(len(holds), tasks, parts, make)


def occupant_of_rest(graph: DerivedTpg, rest: Rest) -> Occupant:
    """Return an object at rest as an occupant."""
    cell, holder = graph.tpg.cell, None
    parts = [b"rest", rest.object.encode(), rest.pose.tobytes()]
    if rest.holder is not None:
        holder = cell.robot(graph.tpg.chains[rest.holder].robot)
        if holder.base_error:
            parts.append(holder.name.encode())
    return Occupant(
        1,
        None,
        lambda: parts,
        lambda: rest_occupancy(cell, rest, graph.entities, holder),
    )


def occupant_of_standing_robot(graph: DerivedTpg, robot: PlacedRobot) -> Occupant:
    """Return a robot without nodes, standing at HOME, as an occupant."""
    return Occupant(
        1,
        None,
        lambda: [b"stand", robot.name.encode()],
        lambda: standing_occupancy(graph.tpg.cell, robot, graph.entities),
    )


class OccupantConflicts:
    """Conflicts of occupants, searched on request.

    Args:
        kept: whether results are cached, also for other graphs of the same cell.
    """

    def __init__(self, *, kept: bool = False) -> None:
        self._kept = kept
        self._found: BoundedCache[Sequence[tuple[int, int]]] = BoundedCache(
            _MOST_CACHED
        )
        self._clear: BoundedCache[bool] = BoundedCache(_MOST_CACHED)
        self._allowed: tuple[AllowedContact, ...] = ()
        self._of_task: dict[int, set[int]] = {}

    def search(
        self, graph: DerivedTpg, a: Occupant, b: Occupant, window: Window
    ) -> Sequence[tuple[int, int]]:
        """Return conflicts (v, u) that imply all others, see ``search_conflicts``."""

        def find() -> Sequence[tuple[int, int]]:
            both = a.occupancy, b.occupancy
            return list(search_conflicts(*both, *window, graph.table))

        if not self._kept:
            return find()
        key = self._query_key(graph, a, b, window)
        return () if key is None else self._found.get(key, find)

    def are_clear(
        self, graph: DerivedTpg, a: Occupant, b: Occupant, window: Window
    ) -> bool:
        """Tell whether none of the queried nodes conflict, see ``search_conflicts``."""

        def find() -> bool:
            both = a.occupancy, b.occupancy
            return first_conflict(*both, *window, graph.table) is None

        if not self._kept:
            return find()
        key = self._query_key(graph, a, b, window)
        return key is None or self._clear.get(key, find)

    def _query_key(
        self, graph: DerivedTpg, a: Occupant, b: Occupant, window: Window
    ) -> bytes | None:
        """Return the cache key of a query, None where it has no nodes."""
        floor, limit = np.maximum(window[0], -1), np.minimum(window[1], b.nodes)
        if np.all(floor + 1 >= limit):
            return None
        digest = hashlib.blake2b(a.content, digest_size=16)
        digest.update(b.content)
        digest.update(floor.tobytes())
        digest.update(limit.tobytes())
        digest.update(self._contacts(graph, a, b))
        return digest.digest()

    def _contacts(self, graph: DerivedTpg, a: Occupant, b: Occupant) -> bytes:
        """Return the allowed contacts of two occupants, by their tasks."""
        allowed = graph.tpg.allowed
        if allowed is not self._allowed:
            self._allowed, self._of_task = allowed, defaultdict(set)
            for k, contact in enumerate(allowed):
                for task in contact.tasks:
                    self._of_task[task].add(k)
        both = set.intersection(
            *(self._entries(s.tasks) for s in (a, b) if s.tasks is not None)
        )
        if not both:
            return b""
        names = sorted(
            (
                allowed[k].first,
                allowed[k].second,
                *(_listed(allowed[k], s) for s in (a, b)),
            )
            for k in both
        )
        return repr(names).encode()

    def _entries(self, tasks: Iterable[int]) -> set[int]:
        return set[int]().union(*(self._of_task.get(task, ()) for task in tasks))


def _listed(contact: AllowedContact, occupant: Occupant) -> tuple[bool, ...]:
    """Return for each task of an occupant whether a contact is allowed in it."""
    return tuple(task in contact.tasks for task in occupant.tasks or ())
