"""A temporal plan graph and what follows from it, each worked out once.

The order of the nodes, the entities and their allowed contacts, where objects are, and what
everything occupies are asked of one ``DerivedTpg`` while edges are drawn, proved and changed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from planning.geometry.robot_bodies import entity_numbers
from planning.parallel import side_by_side
from planning.transforms import Indices
from scheduling.conflicts.close_bodies import ContactTable, contact_table
from scheduling.conflicts.object_spans import (
    Moment,
    ObjectHistory,
    ObjectSpan,
    trace_objects,
)
from scheduling.conflicts.occupancy import Occupancy, chain_occupancy
from scheduling.graph.dispatcher import Rollout, earliest_times
from scheduling.graph.reduction import NodeOrder, order_and_reduce
from scheduling.graph.temporal_plan_graph import Causes, TemporalPlanGraph
from scheduling.graph.total_order import FlatGraph, flatten, planned_ranks


@dataclass(frozen=True, eq=False)
class DerivedTpg:
    """A graph, and what is derived from it when it is first asked for.

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
        return flatten(self.ranks, self.tpg.edges)

    @cached_property
    def order(self) -> NodeOrder:
        """Precedence between nodes that type-1 and type-2 edges impose."""
        return order_and_reduce(self.ranks, self.tpg.edges)[0]

    @cached_property
    def entities(self) -> dict[str, int]:
        """Numbers of the robots' arms and tools and of the handled objects."""
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
        """The objects that are part of each chain's occupancy."""
        return tuple(
            tuple(span for span in self.history.spans if span.robot == chain)
            for chain in range(len(self.tpg.chains))
        )

    @cached_property
    def occupancies(self) -> list[Occupancy]:
        """Occupancy of the nodes of each chain."""
        cell, entities, spans = self.tpg.cell, self.entities, self.spans
        return side_by_side(
            lambda k: chain_occupancy(cell, self.tpg.chains[k], spans[k], entities),
            range(len(self.tpg.chains)),
        )

    @cached_property
    def rollout(self) -> Rollout:
        """Start and end of every node at nominal durations [s]."""
        return earliest_times(self.tpg, flat=self.flat)

    def spans_within(self, chain: int, first: int, stop: int) -> list[ObjectSpan]:
        """Return the objects that are part of some nodes of a chain, numbered from 0.

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
        order, keep = order_and_reduce(self.ranks, edges)
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
            known: attributes of the other graph that are known already.
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
