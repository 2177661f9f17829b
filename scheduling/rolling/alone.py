"""Extensions by themselves: a plan that begins in a world, and knows nothing of what was before."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from planning.cell.workcell import Begun
from planning.tasks.task import AllowedContact
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph


def alone(new: TemporalPlanGraph, first: int, begun: Begun) -> TemporalPlanGraph:
    """Return a graph that begins in a world without the tasks before it.

    Args:
        new: see ``extended``.
        first: index of the first task of its own.
        begun: what was done before.
    """
    return replace(
        new,
        cell=replace(new.cell, begun=begun),
        tasks=tuple(
            replace(task, index=task.index - first) for task in new.tasks[first:]
        ),
        chains=tuple(replace(c, task=c.task - first) for c in new.chains),
        allowed=tuple(
            own for c in new.allowed if (own := _from(c, first)).tasks or not c.tasks
        ),
        dependencies=new.dependencies - first,
        slots=np.empty(0, dtype=np.int64),
        products=np.empty(0, dtype=np.int64),
    )


def _from(contact: AllowedContact, first: int) -> AllowedContact:
    return replace(
        contact, tasks=frozenset(k - first for k in contact.tasks if k >= first)
    )
