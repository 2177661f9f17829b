"""What is brought to a cell while a plan is executed, as nodes of machines.

Something that is brought is nowhere before. Its node comes before all others in the order of the graph, so
that everybody keeps clear of its place all along, and whatever is done to it waits for the node.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import replace

import numpy as np

from planning.cell.workcell import CellObject, Workcell, machine
from planning.tasks.task import PRESENT, STILL, Handling, Task
from planning.transforms import Indices, readonly
from scheduling.graph.temporal_plan_graph import (
    NodeChain,
    NodeHandling,
    TemporalPlanGraph,
)
from scheduling.rolling.extension import committed_part

_LATER = 1.0
"""How much later all others are planned to start than what is brought, so that it comes first [s]."""


def with_supply(
    tpg: TemporalPlanGraph, machine_name: str, name: str, seconds: float = 0.0
) -> TemporalPlanGraph:
    """Return a graph in which a machine brings an object to its start, with dependencies and no new edges.

    Args:
        tpg: the graph, in which the machine has no nodes.
        machine_name: who brings it.
        name: the object.
        seconds: how long that takes.
    """
    index, item = len(tpg.tasks), tpg.cell.object(name)
    still, pose = readonly(np.zeros(1)), readonly(item.start)
    chain = NodeChain(
        machine_name,
        still,
        STILL,
        np.ones(1),
        np.array([0, 1]),
        np.array([index]),
        np.ones(1, dtype=np.bool_),
        np.array([seconds]),
        np.zeros(1),
    )
    brings = Handling(name, 1, None, pose)
    task = Task(
        index, machine_name, PRESENT, 1, f"bring {name}", STILL, (brings,), name
    )
    later = [replace(c, planned_start=c.planned_start + _LATER) for c in tpg.chains]
    handling = NodeHandling(name, len(tpg.chains), 0, 1, None, pose)
    waits = supply_waits(tpg.tasks, {name: index})
    return replace(
        tpg,
        cell=coming(tpg.cell, (replace(item, later=True),), machine_name),
        tasks=(*tpg.tasks, task),
        chains=(*later, chain),
        handlings=(handling, *tpg.handlings),
        dependencies=np.concatenate([tpg.dependencies.reshape(-1, 2), waits]),
    )


def supply_waits(tasks: Iterable[Task], brought: dict[str, int]) -> Indices:
    """Return which tasks wait for what is brought, shape (e, 2).

    Args:
        tasks: some tasks.
        brought: the task in which each object is brought.
    """
    pairs = [
        (brought[task.object], task.index)
        for task in tasks
        if task.object in brought and task.kind != PRESENT
    ]
    return np.array(pairs, dtype=np.int64).reshape(-1, 2)


def brought_by(tasks: Iterable[Task]) -> dict[str, int]:
    """Return the tasks in which objects are brought, by object."""
    return {t.object: t.index for t in tasks if t.kind == PRESENT and t.object}


def coming(
    cell: Workcell, items: Collection[CellObject], machine_name: str
) -> Workcell:
    """Return a cell with objects that come up later, and a machine that brings them."""
    own = {item.name: item for item in items}
    objects = [own.pop(item.name, item) for item in cell.objects]
    names = {item.name for item in cell.machines}
    more = () if machine_name in names else (machine(machine_name),)
    return replace(
        cell,
        objects=(*objects, *own.values()),
        machines=(*cell.machines, *more),
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
