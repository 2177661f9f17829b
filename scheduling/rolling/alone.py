"""Extensions by themselves: a plan that begins in a world, and knows nothing of what was before."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from planning.cell.workcell import Begun
from planning.tasks.task import (
    DOOR,
    GOES_ON,
    STILL,
    Handling,
    Task,
)
from scheduling.graph.temporal_plan_graph import (
    TASK_DEPENDENCY,
    NodeChain,
    TemporalPlanGraph,
    join_chains,
)
from scheduling.rolling.extension import allowed_during

_LATER = 1.0
"""How much later all others are planned to start than what machines go on with, so that it comes first [s]."""


def alone(
    new: TemporalPlanGraph, first: int, begun: Begun, room: int = 0
) -> TemporalPlanGraph:
    """Return a graph that begins in a world without the tasks before it.

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
            for c in allowed_during(new.allowed, range(first, len(new.tasks)))
        ),
        dependencies=new.dependencies + shift,
        slots=np.empty(0, dtype=np.int64),
        products=np.empty(0, dtype=np.int64),
        windows=tuple(window.moved(lambda k: k + shift) for window in new.windows),
    )


def going_on(
    own: TemporalPlanGraph,
    union: TemporalPlanGraph,
    counts: Mapping[str, int],
    left_s: Mapping[str, float],
) -> TemporalPlanGraph:
    """Return a graph in which machines that were at work go on with that first.

    Args:
        own: see ``alone``; it leaves room for a task of each.
        union: what was before it, and it.
        counts: how many nodes of each chain of that were before.
        left_s: how long these machines are at work still [s].
    """
    index, tasks = union.chain_index, []
    for number, (name, seconds) in enumerate(sorted(left_s.items())):
        at, last = index[name], counts[name] - 1
        task = union.tasks[int(union.chains[at].task[last])]
        place = own.chain_index.get(name, len(own.chains))
        node = _node(name, number, seconds)
        chains = [
            replace(c, planned_start=c.planned_start + _LATER) for c in own.chains
        ]
        chains[place : place + 1] = [join_chains([node, *chains[place : place + 1]])]
        edges, handlings = own.edges.copy(), list(own.handlings)
        edges[:, 1] += edges[:, 0] == place
        edges[:, 3] += edges[:, 2] == place
        handlings = [
            replace(h, node=h.node + (h.robot == place)) for h in own.handlings
        ]
        # A door that is shut stays so; what it brings or takes away counts as there or gone.
        shut = {h.object for h in union.handlings if (h.robot, h.node) == (at, last)}
        shut = {name for name in shut if own.cell.object(name).kind == DOOR}
        doors = [
            replace(h, robot=place, node=0)
            for h in union.handlings
            if (h.robot, h.node) == (at, last) and h.object in shut
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
        about = number, name, GOES_ON, task.step, f"{task.label} goes on", STILL
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


def _node(name: str, task: int, seconds: float) -> NodeChain:
    """Return the chain of a machine with the one node that it is at work in."""
    return NodeChain(
        name,
        STILL[0],
        STILL,
        np.ones(1),
        np.array([0, 1]),
        np.array([task]),
        np.ones(1, dtype=np.bool_),
        np.array([seconds]),
        np.zeros(1),
    )
