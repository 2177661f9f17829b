"""Deliveries of objects to a cell during execution, as nodes of machines in a temporal plan graph.

A delivered object does not exist before its delivery. The delivery node comes before all other nodes in the
total order. So all robots keep the place of the object free from the start, and all tasks on the object wait
for the delivery. When a plan starts from an intermediate state of an execution, it begins with the unfinished
tasks of machines.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from planning.cell.machine import machine_robot
from planning.cell.workcell import Begun, CellObject, Workcell
from planning.tasks.task import DOOR, STILL, Handling, Task, TaskKind
from planning.transforms import Indices
from scheduling.graph.temporal_plan_graph import (
    TASK_DEPENDENCY,
    NodeHandling,
    TemporalPlanGraph,
    join_chains,
    pose_nodes,
)
from scheduling.rolling.extension import committed_subgraph, contacts_allowed_during

_LATER = 1.0
"""Offset by which all others start after deliveries and resumed machine work in planned time [s]."""


def with_supply(
    tpg: TemporalPlanGraph,
    who: str,
    item: CellObject | None,
    *,
    label: str,
    step: int = 1,
    seconds: float = 0.0,
) -> TemporalPlanGraph:
    """Return a graph in which a machine delivers an object to its start, or attends to a step.

    It has no new edges, and no dependencies of what waits for it: see ``supply_waits``.

    Args:
        tpg: the graph.
        who: the machine; it does this after all its current work.
        item: what is brought; None for nothing.
        label: of the task.
        step: that it serves.
        seconds: how long it takes.
    """
    index = len(tpg.tasks)
    name = None if item is None else item.name
    brings = () if item is None else (Handling(item.name, 1, None, item.start),)
    task = Task(index, who, TaskKind.BROUGHT, step, label, STILL, brings, name)
    own = pose_nodes(who, STILL[0], STILL, index, seconds, skill=True)
    place = tpg.chain_index.get(who, len(tpg.chains))
    chains = [
        c if k == place else replace(c, planned_start=c.planned_start + _LATER)
        for k, c in enumerate(tpg.chains)
    ]
    node = len(chains[place]) if place < len(chains) else 0
    chains[place : place + 1] = [join_chains([*chains[place : place + 1], own])]
    handled = [NodeHandling(h.object, place, node, 1, None, h.pose) for h in brings]
    return replace(
        tpg,
        cell=with_pending_objects(tpg.cell, () if item is None else (item,), who),
        tasks=(*tpg.tasks, task),
        chains=tuple(chains),
        handlings=(*handled, *tpg.handlings),
    )


def supply_waits(tasks: Sequence[Task], brought: Iterable[Task]) -> Indices:
    """Return the dependencies of some tasks on the deliveries of others, shape (e, 2)."""
    pairs = [
        (own.index, task.index)
        for own in brought
        for task in tasks
        if task.kind not in (TaskKind.BROUGHT, TaskKind.TRANSIT)
        and (task.step == own.step if own.object is None else task.object == own.object)
    ]
    return np.array(pairs, dtype=np.int64).reshape(-1, 2)


def deliveries(tasks: Iterable[Task]) -> list[Task]:
    """Return those of some tasks that are deliveries or attendance."""
    return [task for task in tasks if task.kind == TaskKind.BROUGHT]


def with_pending_objects(
    cell: Workcell, items: Collection[CellObject], who: str
) -> Workcell:
    """Return a cell with objects that arrive later, and the machine that delivers them."""
    own = {item.name: replace(item, later=True) for item in items}
    objects = [own.pop(item.name, item) for item in cell.objects]
    more = () if cell.is_machine(who) else (machine_robot(who),)
    return replace(
        cell,
        objects=(*objects, *own.values()),
        machines=(*cell.machines, *more),
    )


def rename_objects(
    tpg: TemporalPlanGraph, names: Mapping[str, str], first: int
) -> TemporalPlanGraph:
    """Return a graph with renamed objects in its tasks from an index on, but not in its cell."""
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


def remove_idle_chains(
    tpg: TemporalPlanGraph, unused: Collection[int]
) -> TemporalPlanGraph:
    """Return a graph without some chains that have no executed node."""
    if not unused:
        return tpg
    counts = [0 if k in unused else len(own) for k, own in enumerate(tpg.chains)]
    rest = committed_subgraph(tpg, counts)
    # Everything left out belongs to chains that remain.
    names, first = rest.chain_index, rest.chains[0]
    tasks = tuple(
        task
        if task.robot in names
        else replace(task, robot=first.robot, path=first.start[None])
        for task in rest.tasks
    )
    return replace(rest, tasks=tasks)


def drop_history(
    new: TemporalPlanGraph, first: int, begun: Begun, room: int = 0
) -> TemporalPlanGraph:
    """Return a graph that begins in a world, without the tasks before it.

    Args:
        new: see ``extended``.
        first: index of the first task of its own.
        begun: what was done before.
        room: tasks that come before its own.
    """
    shift = room - first
    return replace(
        new,
        cell=replace(new.cell, begun=begun),
        tasks=tuple(
            replace(task, index=task.index + shift) for task in new.tasks[first:]
        ),
        chains=tuple(replace(c, task=c.task + shift) for c in new.chains),
        allowed=tuple(
            replace(c, tasks=frozenset(k + shift for k in c.tasks))
            for c in contacts_allowed_during(new.allowed, range(first, len(new.tasks)))
        ),
        dependencies=new.dependencies + shift,
        slots=np.empty(0, dtype=np.int64),
        products=np.empty(0, dtype=np.int64),
        windows=tuple(window.moved(lambda k: k + shift) for window in new.windows),
    )


def resume_machines(
    own: TemporalPlanGraph,
    union: TemporalPlanGraph,
    counts: Mapping[str, int],
    left_s: Mapping[str, float],
) -> TemporalPlanGraph:
    """Return a graph in which interrupted machines finish their work first.

    Args:
        own: see ``alone``; it leaves room for a task of each.
        union: what was before it, and it.
        counts: how many nodes of each chain of that were before.
        left_s: how long these machines are at work still [s].
    """
    index, tasks = union.chain_index, []
    for number, (name, seconds) in enumerate(sorted(left_s.items())):
        at, last = index[name], counts[name] - 1
        task = union.task_at(at, last)
        place = own.chain_index.get(name, len(own.chains))
        node = pose_nodes(name, STILL[0], STILL, number, seconds, skill=True)
        chains = [
            replace(c, planned_start=c.planned_start + _LATER) for c in own.chains
        ]
        chains[place : place + 1] = [join_chains([node, *chains[place : place + 1]])]
        edges = own.edges.copy()
        edges[:, 1] += edges[:, 0] == place
        edges[:, 3] += edges[:, 2] == place
        handlings = [
            replace(h, node=h.node + (h.robot == place)) for h in own.handlings
        ]
        # A door that is shut stays so; what it brings or takes away counts as there or gone.
        doors = [
            replace(h, robot=place, node=0)
            for h in union.handlings
            if (h.robot, h.node) == (at, last)
            and own.cell.object(h.object).kind == DOOR
        ]
        waits = [
            (place, 0, where, v - counts.get(union.chains[i].robot, 0))
            for k, u, i, v in union.edges.tolist()
            if (k, u) == (at, last)
            and (where := own.chain_index.get(union.chains[i].robot)) is not None
            and v >= counts.get(union.chains[i].robot, 0)
        ]
        more = np.array(waits, dtype=np.int64).reshape(-1, 4)
        why = np.full(len(more), TASK_DEPENDENCY, dtype=np.uint8)
        about = (
            number,
            name,
            TaskKind.GOES_ON,
            task.step,
            f"{task.label} goes on",
            STILL,
        )
        handled = tuple(Handling(h.object, h.waypoint, h.holder, h.pose) for h in doors)
        tasks.append(Task(*about, handled, task.object))
        own = replace(
            own,
            chains=tuple(chains),
            edges=np.concatenate([edges, more]),
            cause=np.concatenate([own.cause, why]),
            handlings=(*doors, *handlings),
        )
    return replace(own, tasks=(*tasks, *own.tasks))
