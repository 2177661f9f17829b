"""Plan for many products, made from the plan of a few products by copying its nodes, tasks and objects.

A ``Pattern`` specifies how the plan is repeated.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from planning.cell.workcell import CellObject
from planning.errors import PlanInvariantError
from planning.tasks.task import AllowedContact, Handling, Task, TimeWindow
from planning.transforms import Indices
from scheduling.graph.temporal_plan_graph import (
    NO_EDGES,
    NodeChain,
    NodeHandling,
    TemporalPlanGraph,
)

_SAME = 1e-9
"""Joint values that differ by less are the same configuration [rad or m]."""


@dataclass(frozen=True)
class Pattern:
    """How the plan of a few products, the pattern, is repeated for many.

    At the end of the pattern everything is again as it was at its start: robots at HOME, sources
    full, places empty. Copies are therefore executed one after another, and may overlap as far as
    the graph allows.

    Attributes:
        products: total number of products.
        period: number of products of the pattern.
        product: the product for which each task of the pattern is done, from 1, shape (tasks,).
            A task that supplies a part to a later copy counts for the product of that copy, and is
            left out if there is no such product.
        lags: triples (a, b, n), shape (d, 3): task b waits for task a of the copy n earlier.
        objects: part and product of each object of the pattern, by name. In the next copy, the
            object is the same part of product + period.
    """

    products: int
    period: int
    product: Indices
    lags: Indices
    objects: Mapping[str, tuple[str, int]]

    @property
    def copies(self) -> int:
        """Number of copies, of which the last one may be truncated."""
        return -(-self.products // self.period)

    @property
    def reach(self) -> int:
        """Largest number of copies between tasks that wait for each other, at least 1."""
        return int(max(1, *self.lags[:, 2])) if len(self.lags) else 1

    def object_of(self, name: str, copy: int) -> str:
        """Return the name of an object in a copy, counted from 0."""
        if name not in self.objects:
            return name
        part, product = self.objects[name]
        return product_part_name(part, product + copy * self.period)


def product_part_name(part: str, product: int) -> str:
    """Return the name of a product's part, counted from 1."""
    return f"{part}.{product}"


def copied_nodes(tpg: TemporalPlanGraph, pattern: Pattern) -> TemporalPlanGraph:
    """Return the nodes of all products, without type-2 edges.

    Every copy is planned to begin when the one before it has ended. Tasks for products beyond the
    total number are left out of the last copy.

    Args:
        tpg: graph of the pattern; robots end where they begin.
        pattern: number of copies, and dependencies between them.

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
    """Builds the graph of all copies from that of the pattern."""

    def __init__(self, tpg: TemporalPlanGraph, pattern: Pattern) -> None:
        self.tpg, self.pattern = tpg, pattern
        copies = np.arange(pattern.copies)[:, None]
        product = pattern.product + copies * pattern.period
        kept = product <= pattern.products
        self.products = product[kept]
        # New index of each task of the pattern, by copy; -1 where it is left out.
        self.index = np.where(kept, np.cumsum(kept).reshape(kept.shape) - 1, -1)
        # Tasks at the start of which robots have tools already, with these: they are taken once.
        self.held = {
            (int(tpg.chains[h.robot].task[h.node]), h.object)
            for h in tpg.handlings
            if tpg.holds_before(h)
        }
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
                if (task.index, h.object) not in self.held
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
        """Return the chain repeated for all copies, truncated in the last one."""
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
            task = chain.task[h.node]
            if index[task] < 0 or (copy and (task, h.object) in self.held):
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
        """Yield the objects of all copies: those after the first one arrive later."""
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
