"""Stretches of a graph, what they consist of and occupy, and how two of them get on.

A stretch is some nodes of a chain, some holds of it, or an object at rest. Whether two of them
conflict depends on what they consist of and who may touch whom in both, not on the graph.
"""

from __future__ import annotations

import hashlib
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from planning.cell.workcell import PlacedRobot
from planning.files import KeptAnswers
from planning.tasks.task import AllowedContact
from planning.transforms import Indices
from scheduling.conflicts.conflict_search import first_conflict, search_conflicts
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.conflicts.object_spans import Rest
from scheduling.conflicts.occupancy import (
    Occupancy,
    chain_occupancy,
    hold_occupancy,
    rest_occupancy,
    standing_occupancy,
)
from scheduling.graph.temporal_plan_graph import NodeChain

_KEPT_ANSWERS = 100_000
"""Answers that are kept."""

Window = tuple[Indices, Indices]
"""Nodes that are asked for: above the floor and below the limit, see ``search_conflicts``."""


@dataclass
class GraphStretch:
    """Part of a graph that occupies space.

    Attributes:
        nodes: how many nodes of its own it has.
        tasks: that it is part of, in order; None for what is part of all, an object at rest.
        parts: returns what it consists of but for its tasks.
        make: returns what it occupies.
    """

    nodes: int
    tasks: tuple[int, ...] | None
    parts: Callable[[], Iterable[bytes]]
    make: Callable[[], Occupancy]

    @cached_property
    def occupancy(self) -> Occupancy:
        """What it occupies, worked out when it is first asked for."""
        return self.make()

    @cached_property
    def content(self) -> bytes:
        """Digest of what it consists of."""
        digest = hashlib.blake2b(digest_size=16)
        for part in self.parts():
            digest.update(part)
        return digest.digest()


def nodes_stretch(
    graph: DerivedTpg,
    chain: int,
    first: int,
    stop: int,
    nodes: NodeChain | None = None,
) -> GraphStretch:
    """Return some nodes of a chain as a stretch, numbered from 0.

    Args:
        graph: the graph.
        chain: the chain.
        first, stop: its nodes ``range(first, stop)``.
        nodes: others that take their place, and carry what they carry.
    """
    own = nodes or graph.tpg.chains[chain].cut(first, stop)
    tasks = tuple(dict.fromkeys(own.task.tolist()))

    spans = graph.spans_within(chain, first, stop)

    def parts() -> Iterable[bytes]:
        yield repr((own.robot, len(own), len(own.waypoints))).encode()
        yield own.start.tobytes()
        yield own.waypoints.tobytes()
        yield own.first.tobytes()
        yield (own.task[1:] != own.task[:-1]).tobytes()
        for span in spans:
            yield repr((span.object, span.start, span.end, span.carried)).encode()
            yield span.pose.tobytes()

    def make() -> Occupancy:
        return chain_occupancy(graph.tpg.cell, own, spans, graph.entities)

    return GraphStretch(len(own), tasks, parts, make)


def holds_stretch(graph: DerivedTpg, chain: int, holds: Indices) -> GraphStretch:
    """Return some holds of a robot as a stretch, see ``hold_occupancy``."""
    nodes, last = graph.tpg.chains[chain], len(graph.tpg.chains[chain]) - 1
    beside = np.clip(np.stack([holds - 1, holds], axis=1), 0, last)
    around = nodes.task[beside].ravel().tolist()
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

    return GraphStretch(len(holds), tasks, parts, make)


def rest_stretch(graph: DerivedTpg, rest: Rest) -> GraphStretch:
    """Return an object at rest as a stretch."""
    return GraphStretch(
        1,
        None,
        lambda: [b"rest", rest.object.encode(), rest.pose.tobytes()],
        lambda: rest_occupancy(graph.tpg.cell, rest, graph.entities),
    )


def standing_stretch(graph: DerivedTpg, robot: PlacedRobot) -> GraphStretch:
    """Return a robot without nodes, which stands at HOME, as a stretch."""
    return GraphStretch(
        1,
        None,
        lambda: [b"stand", robot.name.encode()],
        lambda: standing_occupancy(graph.tpg.cell, robot, graph.entities),
    )


class StretchConflicts:
    """Conflicts of stretches, searched when they are asked for.

    Args:
        kept: whether they are remembered, from one graph of a cell to the next.
    """

    def __init__(self, *, kept: bool = False) -> None:
        self._kept = kept
        self._found: KeptAnswers[Sequence[tuple[int, int]]] = KeptAnswers(_KEPT_ANSWERS)
        self._clear: KeptAnswers[bool] = KeptAnswers(_KEPT_ANSWERS)
        self._allowed: tuple[AllowedContact, ...] = ()
        self._of_task: dict[int, set[int]] = {}

    def search(
        self, graph: DerivedTpg, a: GraphStretch, b: GraphStretch, window: Window
    ) -> Sequence[tuple[int, int]]:
        """Return conflicts (v, u) that imply all others, see ``search_conflicts``."""

        def find() -> Sequence[tuple[int, int]]:
            both = a.occupancy, b.occupancy
            return list(search_conflicts(*both, *window, graph.table))

        if not self._kept:
            return find()
        question = self._question(graph, a, b, window)
        return () if question is None else self._found.get(question, find)

    def are_clear(
        self, graph: DerivedTpg, a: GraphStretch, b: GraphStretch, window: Window
    ) -> bool:
        """Tell whether none of the nodes asked for conflict, see ``search_conflicts``."""

        def find() -> bool:
            both = a.occupancy, b.occupancy
            return first_conflict(*both, *window, graph.table) is None

        if not self._kept:
            return find()
        question = self._question(graph, a, b, window)
        return question is None or self._clear.get(question, find)

    def _question(
        self, graph: DerivedTpg, a: GraphStretch, b: GraphStretch, window: Window
    ) -> bytes | None:
        """Return all that an answer depends on, None where no node is asked for."""
        floor, limit = np.maximum(window[0], -1), np.minimum(window[1], b.nodes)
        if np.all(floor + 1 >= limit):
            return None
        digest = hashlib.blake2b(a.content, digest_size=16)
        digest.update(b.content)
        digest.update(floor.tobytes())
        digest.update(limit.tobytes())
        digest.update(self._contacts(graph, a, b))
        return digest.digest()

    def _contacts(self, graph: DerivedTpg, a: GraphStretch, b: GraphStretch) -> bytes:
        """Return who may touch whom in which tasks of both."""
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


def _listed(contact: AllowedContact, stretch: GraphStretch) -> tuple[bool, ...]:
    """Return for each task of a stretch whether a contact is allowed in it."""
    return tuple(task in contact.tasks for task in stretch.tasks or ())
