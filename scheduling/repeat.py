"""The graph of many products, from the graph of a pattern: edges and proof of few copies.

Whether two nodes conflict depends on their paths and on what is carried, and these are the same in
every copy; who may touch whom is allowed within one copy alone. So a node that conflicts with
one of an earlier copy conflicts with the same one of every earlier copy, and the last of them is
in the copy just before: an edge reaches back no further than one copy, and a wait that the plan
asks for no further than it says. Edges into a copy are therefore those into the one before it,
shifted, as soon as all that they reach back to is there. This is not taken for granted: the graph
of some copies is built and proved as any other, and its edges must repeat.

The invariant then holds for any number of copies. Take a node v of copy m and a robot or an object
that stands for a while in copy n, with which v conflicts. With n = m it was proved in the graph of
few copies, and so it was with n = m - 1 and n = m + 1: v is ordered after the end of that stand in
the copy before, and ahead of its beginning in the copy after. Nodes of one robot are in order,
copy after copy; hence v comes after that stand in all earlier copies and ahead of it in all later.

Copies of the nodes of a pattern, one after another: tasks, objects and contacts of each.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from planning.cell.workcell import CellObject
from planning.errors import PlanInvariantError
from planning.tasks.task import AllowedContact, Handling, Task, TimeWindow
from planning.transforms import Indices
from scheduling.build_tpg import connect_nodes
from scheduling.conflicts.derived_tpg import DerivedTpg
from scheduling.graph.task_edges import task_nodes
from scheduling.graph.temporal_plan_graph import (
    NO_EDGES,
    NodeChain,
    NodeHandling,
    TemporalPlanGraph,
)
from scheduling.graph.total_order import order_and_reduce, planned_ranks

_SAME = 1e-9
"""Joint values that differ by less are the same configuration [rad or m]."""


@dataclass(frozen=True)
class Pattern:
    """A plan for some products that is repeated for many.

    At the end of the pattern everything is again as it was at its start: robots at HOME, sources
    full, places empty. So its copies come one after another, and overlap as the graph lets them.

    Attributes:
        products: how many there are to be in all.
        period: products of the pattern.
        product: the product for which each task of the pattern is done, from 1, shape (tasks,).
            What brings parts of a later copy is done for a product of that one, and is left out
            where there is no such product.
        lags: triples (a, b, n), shape (d, 3): task b of the copy that is n later waits for task
            a of a copy.
        objects: by name of an object of the pattern, its part and product: in the copy after it
            is that of product + period.
    """

    products: int
    period: int
    product: Indices
    lags: Indices
    objects: Mapping[str, tuple[str, int]]

    @property
    def copies(self) -> int:
        """Number of copies, of which the last one may be cut short."""
        return -(-self.products // self.period)

    @property
    def reach(self) -> int:
        """Number of copies over which tasks wait for each other at most, at least 1."""
        return int(max(1, *self.lags[:, 2])) if len(self.lags) else 1

    def object_of(self, name: str, copy: int) -> str:
        """Return the name that something has in a copy, counted from 0."""
        if name not in self.objects:
            return name
        part, product = self.objects[name]
        return numbered(part, product + copy * self.period)


def numbered(part: str, product: int) -> str:
    """Return the name of a product's part, counted from 1."""
    return f"{part}.{product}"


def copied_nodes(tpg: TemporalPlanGraph, pattern: Pattern) -> TemporalPlanGraph:
    """Return the nodes of all products, without type-2 edges.

    Every copy is planned to begin when the one before it has ended. Tasks for products that
    there are not to be are left out of the last one.

    Args:
        tpg: of the pattern, robots ending where they begin.
        pattern: says how often, and what waits for what between copies.

    Raises:
        PlanInvariantError: a robot does not end where it begins.
    """
    _require_return(tpg)
    return _Copies(tpg, pattern).graph()


def _require_return(tpg: TemporalPlanGraph) -> None:
    for chain in tpg.chains:
        if len(chain.waypoints):
            off = float(np.max(np.abs(chain.waypoints[-1] - chain.start)))
            if off > _SAME:
                raise PlanInvariantError(
                    f"robot {chain.robot!r} ends {off:.3g} away from where it begins: what it"
                    " does cannot be repeated"
                )


class _Copies:
    """Copies the parts of one graph."""

    def __init__(self, tpg: TemporalPlanGraph, pattern: Pattern) -> None:
        self.tpg, self.pattern = tpg, pattern
        copies = np.arange(pattern.copies)[:, None]
        product = pattern.product + copies * pattern.period
        kept = product <= pattern.products
        self.products = product[kept]
        # The new index of each task of the pattern in a copy, -1 where it is left out.
        self.index = np.where(kept, np.cumsum(kept).reshape(kept.shape) - 1, -1)
        ends = [c.planned_start + c.duration for c in tpg.chains if len(c)]
        self.length_s = max(float(end.max()) for end in ends)

    def graph(self) -> TemporalPlanGraph:
        tpg = self.tpg
        tasks = tuple(task for k in self._copies() for task in self._tasks(k))
        handlings = tuple(h for k in self._copies() for h in self._handlings(k))
        handled = {h.object for h in handlings}
        cell = replace(tpg.cell, objects=tuple(self._objects(handled)))
        chains = [self._chain(chain) for chain in tpg.chains]
        place = np.cumsum([len(chain) > 0 for chain in chains]) - 1
        handlings = tuple(replace(h, robot=int(place[h.robot])) for h in handlings)
        return TemporalPlanGraph(
            cell,
            tasks,
            tuple(chain for chain in chains if len(chain)),
            *NO_EDGES,
            handlings,
            tuple(a for k in self._copies() for a in self._allowed(k)),
            self._dependencies(),
            products=self.products,
            windows=tuple(w for k in self._copies() for w in self._windows(k)),
        )

    def _copies(self) -> range:
        return range(self.pattern.copies)

    def _name(self, name: str, copy: int) -> str:
        return self.pattern.object_of(name, copy)

    def _tasks(self, copy: int) -> Iterator[Task]:
        steps = max(task.step for task in self.tpg.tasks)
        for task, index in zip(self.tpg.tasks, self.index[copy].tolist(), strict=True):
            if index < 0:
                continue
            if copy == 0:
                yield replace(task, index=index)
                continue
            name = None if task.object is None else self._name(task.object, copy)
            label = task.label
            if task.object is not None and name is not None:
                label = label.replace(task.object, name)
            handlings = tuple(
                Handling(self._name(h.object, copy), h.waypoint, h.holder, h.pose)
                for h in task.handlings
            )
            yield replace(
                task,
                index=index,
                step=task.step + copy * steps,
                label=label,
                object=name,
                handlings=handlings,
            )

    def _chain(self, chain: NodeChain) -> NodeChain:
        """Return a chain again and again, the last time as far as it goes."""
        last = self.pattern.copies - 1
        left = self.index[last, chain.task] >= 0
        rest = int(np.count_nonzero(left))
        if not np.all(left[:rest]):
            raise PlanInvariantError(
                f"{chain.robot!r} works for a product before it is done with an earlier one"
            )
        times = last + (rest > 0)
        if times == 0:
            return chain.cut(0, 0)
        counts = np.diff(chain.first)
        tasks = [self.index[k, chain.task] for k in range(times)]
        starts = [chain.planned_start + k * self.length_s for k in range(times)]
        whole = NodeChain(
            chain.robot,
            chain.start,
            np.tile(chain.waypoints, (times, 1)),
            np.tile(chain.fraction, times),
            np.concatenate([[0], np.cumsum(np.tile(counts, times))]).astype(np.int64),
            np.concatenate(tasks),
            np.tile(chain.skill, times),
            np.tile(chain.duration, times),
            np.concatenate(starts),
            drive=None if chain.drive is None else chain.drive.repeated(times),
            corners=None
            if chain.corners is None
            else chain.corners.repeated(times, len(chain)),
        )
        return whole.cut(0, last * len(chain) + rest).frozen()

    def _handlings(self, copy: int) -> Iterator[NodeHandling]:
        index = self.index[copy]
        for h in self.tpg.handlings:
            chain = self.tpg.chains[h.robot]
            if index[chain.task[h.node]] < 0:
                continue
            yield NodeHandling(
                self._name(h.object, copy),
                h.robot,
                h.node + copy * len(chain),
                h.waypoint,
                h.holder,
                h.pose,
            )

    def _objects(self, handled: set[str]) -> Iterator[CellObject]:
        """Yield the objects of all copies: of all but the first one they come up later."""
        known: set[str] = set()
        for copy in self._copies():
            for item in self.tpg.cell.objects:
                name = self._name(item.name, copy)
                if name in known:
                    continue
                known.add(name)
                if copy == 0 and name == item.name and not item.later:
                    yield item
                elif name in handled:
                    yield replace(item, name=name, later=True)

    def _allowed(self, copy: int) -> Iterator[AllowedContact]:
        index = self.index[copy]
        for contact in self.tpg.allowed:
            tasks = index[sorted(contact.tasks)]
            if np.any(tasks >= 0):
                yield AllowedContact(
                    self._name(contact.first, copy),
                    self._name(contact.second, copy),
                    frozenset(tasks[tasks >= 0].tolist()),
                    contact.grazing,
                    contact.depth,
                )

    def _windows(self, copy: int) -> Iterator[TimeWindow]:
        index = self.index[copy]
        for window in self.tpg.windows:
            begun, done, due = index[[window.begun, window.done, window.due]].tolist()
            if min(begun, done, due) >= 0:
                words = f"{window.words}, copy {copy + 1}"
                yield replace(window, begun=begun, done=done, due=due, words=words)

    def _dependencies(self) -> Indices:
        within = np.insert(self.tpg.dependencies, 2, 0, axis=1)
        found = []
        for a, b, lag in np.concatenate([within, self.pattern.lags]).tolist():
            for copy in range(self.pattern.copies - lag):
                pair = self.index[copy, a], self.index[copy + lag, b]
                if min(pair) >= 0:
                    found.append(pair)
        return np.array(sorted(set(found)), dtype=np.int64).reshape(-1, 2)


_MORE = 4
"""Copies that are built beyond those needed before it is given up that edges repeat."""


def repeat_graph(
    tpg: TemporalPlanGraph,
    pattern: Pattern,
) -> TemporalPlanGraph:
    """Return the graph of all products of a pattern, reduced and proved.

    Args:
        tpg: of the pattern.
        pattern: how it is repeated.

    Raises:
        PlanInvariantError: a robot or object that stands in one copy is in the way of a motion
            in another, or copies do not repeat.
    """
    least = pattern.reach + 3
    for copies in range(least, least + _MORE + 1):
        if pattern.copies <= copies:
            return connect_nodes(DerivedTpg(copied_nodes(tpg, pattern)))
        cut = pattern.copies - copies
        short = replace(pattern, products=pattern.products - cut * pattern.period)
        few = connect_nodes(DerivedTpg(copied_nodes(tpg, short)))
        lengths = [len(chain) for chain in tpg.chains]
        edges = _Edges(few.edges, few.cause, np.array(lengths, dtype=np.int64))
        if edges.repeat(copies - 2):
            return _whole(tpg, pattern, edges, copies)
    raise PlanInvariantError(
        f"what {least + _MORE} copies of the plan of a product wait for does not repeat"
    )


class _Edges:
    """Type-2 edges of some copies, by the copy that they lead into.

    Args:
        edges: shape (e, 4).
        cause: shape (e,).
        lengths: nodes of each chain in one copy, shape (chains,).
    """

    def __init__(
        self, edges: Indices, cause: npt.NDArray[np.uint8], lengths: Indices
    ) -> None:
        self.edges, self.cause, self.lengths = edges, cause, lengths
        self._copy = edges[:, 3] // lengths[edges[:, 2]]

    def into(self, copy: int, by: int = 0) -> tuple[Indices, npt.NDArray[np.uint8]]:
        """Return the edges into a copy, counted from 0, and their causes, shifted by copies."""
        own = self._copy == copy
        edges = self.edges[own].copy()
        edges[:, 1] += by * self.lengths[edges[:, 0]]
        edges[:, 3] += by * self.lengths[edges[:, 2]]
        return edges, self.cause[own]

    def repeat(self, copy: int) -> bool:
        """Tell whether edges into a copy are those into the one before it, shifted by one."""
        before, why = self.into(copy - 1, 1)
        edges, cause = self.into(copy)
        return np.array_equal(before, edges) and np.array_equal(why, cause)


def _whole(
    tpg: TemporalPlanGraph, pattern: Pattern, few: _Edges, copies: int
) -> TemporalPlanGraph:
    """Return the graph of all copies, whose edges are those of few, shifted."""
    parts = [few.into(copy) for copy in range(copies - 1)]
    steady = copies - 2
    parts += [few.into(steady, by) for by in range(1, pattern.copies - copies + 1)]
    parts.append(few.into(copies - 1, pattern.copies - copies))
    edges = np.concatenate([part for part, _ in parts])
    cause = np.concatenate([why for _, why in parts])
    order = np.lexsort(edges.T[::-1])
    graph = replace(copied_nodes(tpg, pattern), edges=edges[order], cause=cause[order])
    _require_waits(graph)
    return graph


def _require_waits(tpg: TemporalPlanGraph) -> None:
    """Require that edges follow the planned order and keep all dependencies of tasks."""
    order, _ = order_and_reduce(planned_ranks(tpg.chains), tpg.edges)
    nodes = {own.task: own for chain in task_nodes(tpg.chains) for own in chain}
    for a, b in tpg.dependencies.tolist():
        if a not in nodes or b not in nodes:
            continue
        u, v = nodes[a], nodes[b]
        if u.chain != v.chain and not order.precedes(
            u.chain, u.stop - 1, v.chain, v.first
        ):
            raise PlanInvariantError(f"task {b} does not wait for task {a} any more")
