"""What is brought to a cell while a plan is executed, as nodes of machines.

Something that is brought is nowhere before. Its node comes before all others in the order of the graph, so
that everybody keeps clear of its place all along, and whatever is done to it waits for the node.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from planning.cell.workcell import CellObject, Workcell, machine
from planning.tasks.task import BROUGHT, STILL, TRANSIT, Handling, Task
from planning.transforms import Indices, readonly
from scheduling.graph.temporal_plan_graph import (
    NodeChain,
    NodeHandling,
    TemporalPlanGraph,
    join_chains,
)
from scheduling.rolling.extension import committed_part

_LATER = 1.0
"""How much later all others are planned to start than what is brought, so that it comes first [s]."""


def with_supply(
    tpg: TemporalPlanGraph,
    who: str,
    item: CellObject | None,
    *,
    label: str,
    step: int = 1,
    seconds: float = 0.0,
) -> TemporalPlanGraph:
    """Return a graph in which a machine brings an object to its start, or sees to a step.

    It has no new edges, and no dependencies of what waits for it: see ``supply_waits``.

    Args:
        tpg: the graph.
        who: the machine; it does this after whatever it does already.
        item: what is brought; None for nothing.
        label: of the task.
        step: that it serves.
        seconds: how long it takes.
    """
    index, still = len(tpg.tasks), readonly(np.zeros(1))
    name = None if item is None else item.name
    brings = () if item is None else (Handling(item.name, 1, None, item.start),)
    task = Task(index, who, BROUGHT, step, label, STILL, brings, name)
    own = NodeChain(
        who,
        still,
        STILL,
        np.ones(1),
        np.array([0, 1]),
        np.array([index]),
        np.ones(1, dtype=np.bool_),
        np.array([seconds]),
        np.zeros(1),
    )
    place = tpg.chain_index.get(who, len(tpg.chains))
    chains = [
        c if k == place else replace(c, planned_start=c.planned_start + _LATER)
        for k, c in enumerate(tpg.chains)
    ]
    node = len(chains[place]) if place < len(chains) else 0
    chains[place : place + 1] = [
        join_chains([chains[place], own]) if place < len(chains) else own
    ]
    handled = [NodeHandling(h.object, place, node, 1, None, h.pose) for h in brings]
    return replace(
        tpg,
        cell=coming(tpg.cell, () if item is None else (item,), who),
        tasks=(*tpg.tasks, task),
        chains=tuple(chains),
        handlings=(*handled, *tpg.handlings),
    )


def supply_waits(tasks: Sequence[Task], brought: Iterable[Task]) -> Indices:
    """Return which of some tasks wait for what others bring or see to, shape (e, 2)."""
    pairs = [
        (own.index, task.index)
        for own in brought
        for task in tasks
        if task.kind not in (BROUGHT, TRANSIT)
        and (task.step == own.step if own.object is None else task.object == own.object)
    ]
    return np.array(pairs, dtype=np.int64).reshape(-1, 2)


def brought_in(tasks: Iterable[Task]) -> list[Task]:
    """Return those of some tasks in which something is brought or seen to."""
    return [task for task in tasks if task.kind == BROUGHT]


def coming(cell: Workcell, items: Collection[CellObject], who: str) -> Workcell:
    """Return a cell with objects that come up later, and the machine that brings them."""
    own = {item.name: replace(item, later=True) for item in items}
    objects = [own.pop(item.name, item) for item in cell.objects]
    more = () if cell.is_machine(who) else (machine(who),)
    return replace(
        cell,
        objects=(*objects, *own.values()),
        machines=(*cell.machines, *more),
    )


def renamed(
    tpg: TemporalPlanGraph, names: Mapping[str, str], first: int
) -> TemporalPlanGraph:
    """Return a graph in which objects have other names, in its tasks from an index on; not in its cell."""
    if not names:
        return tpg

    def other(task: Task) -> Task:
        words = task.label.split(" ")
        return replace(
            task,
            object=names.get(task.object or "", task.object),
            label=" ".join(names.get(word, word) for word in words),
            handlings=tuple(
                replace(h, object=names.get(h.object, h.object)) for h in task.handlings
            ),
        )

    return replace(
        tpg,
        tasks=(*tpg.tasks[:first], *map(other, tpg.tasks[first:])),
        handlings=tuple(
            replace(h, object=names.get(h.object, h.object)) for h in tpg.handlings
        ),
        allowed=tuple(
            replace(
                c,
                first=names.get(c.first, c.first),
                second=names.get(c.second, c.second),
            )
            for c in tpg.allowed
        ),
    )


def without_chains(
    tpg: TemporalPlanGraph, unused: Collection[int]
) -> TemporalPlanGraph:
    """Return a graph without some chains, none of whose nodes was executed."""
    if not unused:
        return tpg
    counts = [0 if k in unused else len(own) for k, own in enumerate(tpg.chains)]
    rest = committed_part(tpg, counts)
    # What is left out belongs to somebody who is there.
    names, first = rest.chain_index, rest.chains[0]
    tasks = tuple(
        task
        if task.robot in names
        else replace(task, robot=first.robot, path=first.start[None])
        for task in rest.tasks
    )
    return replace(rest, tasks=tasks)
