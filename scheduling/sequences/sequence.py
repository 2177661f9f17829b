"""Plans that are executed one after another, and the nodes of all of them in one graph.

Plans that are executed several times are stored once. Each time is a ``SequencedPlan``, which says what the objects of
the plan are called in it.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from planning.cell.workcell import CellObject
from planning.errors import PlanInvariantError
from planning.tasks.task import AllowedContact, Handling, Task, TimeWindow
from planning.transforms import Array, Indices, Transform
from scheduling.graph.temporal_plan_graph import (
    NO_EDGES,
    NodeChain,
    NodeHandling,
    TemporalPlanGraph,
    join_chains,
    joined_corners,
    joined_drives,
)
from scheduling.graph.total_order import NodeOrder

_SAME = 1e-9
"""Joint values that differ by less are the same configuration [rad or m]."""

_SAME_POSE = 1e-6
"""Entries of poses that differ by less are the same pose [m, and of rotations]."""


@dataclass(frozen=True)
class SequencedPlan:
    """A plan in a sequence.

    Attributes:
        plan: its index among the plans of the sequence.
        names: names of its objects in the sequence, by their names in the plan; others keep theirs.
        products: the product that each of its tasks is for, from 1, shape (tasks,).
    """

    plan: int
    names: Mapping[str, str]
    products: Indices


@dataclass(frozen=True)
class PlanSequence:
    """Plans that are executed one after another, and overlap as far as the graph allows.

    Attributes:
        plans: of the same robots and fixtures, each in some segment; what is at rest when a plan begins is in its cell.
        segments: in order of execution.
        waits: rows (a, t, b, u), shape (d, 4): task u of segment b waits for task t of segment a.
    """

    plans: tuple[TemporalPlanGraph, ...]
    segments: tuple[SequencedPlan, ...]
    waits: Indices

    def moved(self) -> list[frozenset[str]]:
        """Return for each plan the names in it of objects that any plan handles."""
        handled = [frozenset(h.object for h in plan.handlings) for plan in self.plans]
        every = {s.names.get(x, x) for s in self.segments for x in handled[s.plan]}
        own: list[set[str]] = [set(names) for names in handled]
        for s in self.segments:
            objects = (item.name for item in self.plans[s.plan].cell.objects)
            own[s.plan].update(x for x in objects if s.names.get(x, x) in every)
        return list(map(frozenset, own))


class SequenceNodes:
    """The nodes of all plans of a sequence.

    Each plan is planned to begin when the one before it has ended.

    Args:
        sequence: the plans.

    Raises:
        PlanInvariantError: a robot or an object is not where a plan of the sequence begins with it.
    """

    def __init__(self, sequence: PlanSequence) -> None:
        self._sequence, plans = sequence, sequence.plans
        machines = {item.name: item for plan in plans for item in plan.cell.machines}
        self._cell = replace(plans[0].cell, machines=tuple(machines.values()))
        working = {chain.robot for plan in plans for chain in plan.chains}
        places = (*self._cell.robots, *self._cell.machines)
        self._robots = [place.name for place in places if place.name in working]
        self._order = np.array([s.plan for s in sequence.segments], dtype=np.int64)
        # Chain in the sequence of each chain of each plan.
        self._chains = [
            np.array([self._robots.index(c.robot) for c in plan.chains], dtype=np.int64)
            for plan in plans
        ]
        nodes = np.zeros((len(plans), len(self._robots)), dtype=np.int64)
        for row, plan, own in zip(nodes, plans, self._chains, strict=True):
            row[own] = [len(chain) for chain in plan.chains]
        # Number of nodes of each chain, and of tasks and steps, before each segment.
        self._nodes = self._before(nodes)
        self._tasks = self._before([len(plan.tasks) for plan in plans])
        steps = [max((task.step for task in plan.tasks), default=0) for plan in plans]
        self._steps = self._before(steps)
        self._require_return()

    def _before(self, of_plans: object) -> Indices:
        counts = np.asarray(of_plans, dtype=np.int64)[self._order]
        return np.concatenate([np.zeros_like(counts[:1]), np.cumsum(counts, axis=0)])

    def edges(self, edges: Indices, source: int, target: int) -> Indices:
        """Return type-2 edges between nodes of two segments, or of one, as edges of the sequence, shape (e, 4)."""
        moved = edges.copy()
        for column, segment in ((0, source), (2, target)):
            chains = self._chains[self._order[segment]][edges[:, column]]
            moved[:, column] = chains
            moved[:, column + 1] += self._nodes[segment][chains]
        return moved

    def unordered(
        self, source: int, target: int, known: NodeOrder | None
    ) -> list[tuple[int, int]]:
        """Return the chains of a segment, each with a chain of an earlier one after which not all of its nodes are.

        Args:
            source, target: the earlier segment and the later one.
            known: order of the nodes of the sequence, None for none.
        """
        before = self._chains[self._order[source]]
        after = self._chains[self._order[target]]
        open_ = np.ones((len(after), len(before)), dtype=np.bool_)
        if known is not None:
            first = known.first[after] + self._nodes[target][after]
            open_ = known.clock[first][:, before] < self._nodes[source + 1][before] - 1
        return [(i, k) for i, k in np.argwhere(open_).tolist()]

    def graph(self) -> TemporalPlanGraph:
        """Return the nodes of all segments, without type-2 edges."""
        segments = range(len(self._order))
        begins = self._begins()
        chains = [self._chain(robot, begins) for robot in self._robots]
        plans, waits = self._sequence.plans, self._sequence.waits
        pairs = [
            plans[plan].dependencies + self._tasks[m]
            for m, plan in enumerate(self._order)
        ]
        pairs.append(self._tasks[waits[:, [0, 2]]] + waits[:, [1, 3]])
        return TemporalPlanGraph(
            replace(self._cell, objects=tuple(self._objects())),
            tuple(task for m in segments for task in self._tasks_of(m)),
            tuple(chains),
            *NO_EDGES,
            tuple(h for m in segments for h in self._handlings(m)),
            tuple(a for m in segments for a in self._allowed(m)),
            np.unique(np.concatenate(pairs), axis=0),
            products=np.concatenate([s.products for s in self._sequence.segments]),
            windows=tuple(w for m in segments for w in self._windows(m)),
        )

    def _require_return(self) -> None:
        """Require that each robot ends every plan but the last where all plans begin with it."""
        plans, followed = self._sequence.plans, set(self._order[:-1].tolist())
        for robot in self._robots:
            home = self._cell.robot(robot).home
            stands = [_begin(plan, robot, home) for plan in plans]
            for k in followed:
                if (own := plans[k].chain_index.get(robot)) is not None:
                    chain = plans[k].chains[own]
                    stands.append(chain.stands_at(len(chain)))
            off = float(np.max(np.abs(np.stack(stands) - stands[0])))
            if off > _SAME:
                raise PlanInvariantError(
                    f"robot {robot!r} ends {off:.3g} away from where it begins: what it"
                    " does cannot be repeated"
                )

    def _begins(self) -> list[float]:
        """Return the planned begin of each segment [s]."""
        plans = self._sequence.plans
        ends = [
            max(float(np.max(c.planned_start + c.duration)) for c in plan.chains)
            for plan in plans
        ]
        latest = [
            max(float(c.planned_start[-1]) for c in plan.chains) for plan in plans
        ]
        times, begins, earliest = np.zeros(len(plans), dtype=np.int64), [], 0.0
        for plan in self._order:
            # Rounding must not put a node before those of the segment before.
            begins.append(max(float(times @ ends), earliest))
            earliest = begins[-1] + latest[plan]
            times[plan] += 1
        return begins

    def _chain(self, robot: str, begins: list[float]) -> NodeChain:
        """Return the nodes of a robot in all segments."""
        own = [plan.chain_index.get(robot) for plan in self._sequence.plans]
        parts, first = [], []
        for m, plan in enumerate(self._order):
            if (k := own[plan]) is not None:
                chain = self._sequence.plans[plan].chains[k]
                parts.append(
                    replace(
                        chain,
                        task=chain.task + self._tasks[m],
                        planned_start=chain.planned_start + begins[m],
                    )
                )
                first.append(int(self._nodes[m][self._robots.index(robot)]))
        drives = [part.drive for part in parts if part.drive is not None]
        corners = joined_corners(
            *((part.corners, by) for part, by in zip(parts, first, strict=True))
        )
        drive = joined_drives(drives) if drives else None
        return replace(join_chains(parts), drive=drive, corners=corners).frozen()

    def _parts(self, m: int) -> tuple[TemporalPlanGraph, Mapping[str, str], int]:
        """Return the plan of a segment, its names, and the number of tasks before it."""
        segment = self._sequence.segments[m]
        plan = self._sequence.plans[segment.plan]
        return plan, segment.names, int(self._tasks[m])

    def _held(self, m: int) -> list[NodeHandling]:
        """Return the handlings by which robots have something in their hands before their first nodes."""
        plan = self._parts(m)[0]
        return [h for h in plan.handlings if plan.holds_before(h)]

    def _tasks_of(self, m: int) -> Iterator[Task]:
        plan, names, before = self._parts(m)
        held = {(plan.task_of(h).index, h.object) for h in self._held(m) if m}
        for task in plan.tasks:
            name = None if task.object is None else names.get(task.object, task.object)
            label = task.label
            if task.object is not None and name is not None:
                label = label.replace(task.object, name)
            handlings = tuple(
                Handling(names.get(h.object, h.object), h.waypoint, h.holder, h.pose)
                for h in task.handlings
                if (task.index, h.object) not in held
            )
            yield replace(
                task,
                index=task.index + before,
                step=task.step + int(self._steps[m]),
                label=label,
                object=name,
                handlings=handlings,
            )

    def _handlings(self, m: int) -> Iterator[NodeHandling]:
        plan, names, _ = self._parts(m)
        chains = self._chains[self._order[m]].tolist()
        held = {id(h) for h in self._held(m) if m}
        for h in plan.handlings:
            if id(h) in held:
                continue
            chain = chains[h.robot]
            node = h.node + int(self._nodes[m][chain])
            name = names.get(h.object, h.object)
            yield replace(h, object=name, robot=chain, node=node)

    def _allowed(self, m: int) -> Iterator[AllowedContact]:
        plan, names, before = self._parts(m)
        for contact in plan.allowed:
            yield replace(
                contact,
                first=names.get(contact.first, contact.first),
                second=names.get(contact.second, contact.second),
                tasks=frozenset(task + before for task in contact.tasks),
            )

    def _windows(self, m: int) -> Iterator[TimeWindow]:
        plan, _, before = self._parts(m)
        for own in plan.windows:
            times = {
                key: getattr(own, key) + before for key in ("begun", "done", "due")
            }
            yield replace(own, words=f"{own.words}, copy {m + 1}", **times)

    def _objects(self) -> Iterator[CellObject]:
        """Yield the objects of all segments; those that the first one does not begin with come later.

        Raises:
            PlanInvariantError: a plan begins with other objects at rest than the one before ends with.
        """
        known: set[str] = set()
        rests: dict[str, Transform] = {}
        held: dict[str, str | None] = {}
        changes = [{h.object: h for h in x.handlings} for x in self._sequence.plans]
        for m, k in enumerate(self._order.tolist()):
            plan, names, _ = self._parts(m)
            items = {names.get(x.name, x.name): x for x in plan.cell.objects}
            taken = {names.get(h.object, h.object): h.holder for h in self._held(m)}
            begin = {
                name: x.start
                for name, x in items.items()
                if not x.later and name not in taken
            }
            handled = {names.get(h.object, h.object) for h in plan.handlings}
            if m == 0:
                rests, held = dict(begin), taken
            elif len(plan.machine_chains()) < len(plan.chains):
                _require_rests(rests, begin, handled - taken.keys(), m)
                if taken != held:
                    raise PlanInvariantError(
                        f"plan {m + 1} begins with {sorted(taken)} in hands, the one"
                        f" before ends with {sorted(held)}"
                    )
            for name, item in items.items():
                if name not in known and (
                    name in handled or (m == 0 and name in begin)
                ):
                    known.add(name)
                    yield replace(item, name=name, later=item.later or m > 0)
            for local, last in changes[k].items():
                name = names.get(local, local)
                rests.pop(name, None)
                held.pop(name, None)
                if last.holder is None:
                    rests[name] = last.pose
                elif last.holder != Handling.GONE:
                    held[name] = last.holder


def _begin(plan: TemporalPlanGraph, robot: str, home: Array) -> Array:
    """Return where a robot begins a plan, shape (n,): HOME if it has no nodes."""
    k = plan.chain_index.get(robot)
    return home if k is None else plan.chains[k].start


def _require_rests(
    rests: Mapping[str, Transform],
    begin: Mapping[str, Transform],
    handled: Collection[str],
    segment: int,
) -> None:
    """Require that a segment begins with the objects at rest with which the one before it ends.

    Further ones may be in the plan as obstacles if it does not handle them.

    Raises:
        PlanInvariantError: an object is missing, elsewhere, or not there.
    """
    for name in rests.keys() | (begin.keys() & handled):
        if name not in begin or name not in rests:
            missing = (
                "at its begin" if name not in begin else "at the end of the one before"
            )
            raise PlanInvariantError(f"plan {segment + 1} lacks {name!r} {missing}")
        if not np.allclose(rests[name], begin[name], rtol=0.0, atol=_SAME_POSE):
            raise PlanInvariantError(
                f"plan {segment + 1} begins with {name!r} elsewhere than the one before ends"
            )
