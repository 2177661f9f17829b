"""Parts that would fall, and that who placed them keeps hold of until others are in place."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import NamedTuple

from planning.tasks.task import FAILED, LEFT_OUT, TRANSIT, Task
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph


class KeptHold(NamedTuple):
    """A part in its place that is kept hold of, or was.

    Attributes:
        part: its name.
        robot: who keeps hold of it.
        last: what has come by which it stands; nothing as long as nothing has.
        left: whether its robot has left it.
    """

    part: str
    robot: str
    last: str
    left: bool


def kept_hold(tpg: TemporalPlanGraph, complete: Collection[int]) -> Iterator[KeptHold]:
    """Yield the parts that are kept hold of in their places when some tasks are complete, or were.

    The way back of who keeps hold of a part is a task of its own that is about the part and in which nothing
    changes hands; it waits for what is put down until then. Of all others it belongs to the skill that places.
    """
    until: dict[int, Task] = {}
    for first, second in tpg.dependencies.tolist():
        if tpg.tasks[first].kind == "place-down":
            until[second] = tpg.tasks[first]
    before: dict[str, Task] = {}
    for task in tpg.tasks:
        if task.kind in (LEFT_OUT, FAILED):
            continue
        put = before.get(task.robot)
        before[task.robot] = task
        if put is None or task.kind != TRANSIT or put.kind != "place-down":
            continue
        if task.object == put.object is not None and put.index in complete:
            own = until.get(task.index)
            there = own is not None and own.index in complete
            last = str(own.object) if own is not None and there else ""
            yield KeptHold(put.object, task.robot, last, task.index in complete)
