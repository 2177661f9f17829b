"""Disposal of a rejected part: a robot picks it where it lies, and drops it into a bin."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from planning.cell.workcell import Attachment
from planning.contacts.touching import nearby_entities, standing_fixtures
from planning.grips.grip import DOWN
from planning.grips.tool_grips import tool_grips
from planning.parts.assembly import PlacePart
from planning.parts.candidates import PartCandidates, PartCollector
from planning.parts.expansion import step_tasks
from planning.parts.part_steps import PartStep
from planning.parts.supply import Supply
from planning.tasks.assembly import Disposal
from planning.tasks.assignment import StepChoice, TaskPlan
from planning.tasks.task import Handling, StepTasks, Task
from planning.transforms import Transform

_MOST = 8
"""Greatest number of grips tried."""


def disposal_tasks(
    candidates: PartCandidates,
    order: Disposal,
    lying: Mapping[str, Transform],
    plan: TaskPlan,
    first: int,
) -> Iterator[StepTasks]:
    """Yield the tasks by which a robot drops a part into a bin; see ``Assembly.disposals``.

    There are none for a part that is joined to another one that is there, and where robots change tools.
    """
    cell, assembly, name = candidates.cell, candidates.assembly, order.part
    joined = lying.keys() & set(assembly.joined_to(name))
    if joined or candidates.changes.mounted or order.pose is None:
        return
    there = {item.name: item for item in cell.objects if item.name in lying}
    part = replace(there.pop(name), start=lying[name])
    around = {k: (item, Attachment(None, lying[k])) for k, item in there.items()}
    placed = standing_fixtures(cell) | {k: (v, lying[k]) for k, v in there.items()}
    at_bin, at_start = (
        nearby_entities((part, pose), placed, assembly.touch)
        for pose in (order.pose, part.start)
    )
    handling = assembly.handling(name)
    if not np.allclose(part.start, cell.object(name).start):
        x, y, z = handling.insertion  # the way by which it came
        handling = replace(handling, extraction=(-x, -y, -z))
    ends = part.start, order.pose, handling.grips
    grips = tool_grips(cell.robots, part.shape, *ends)
    about = PlacePart(part=name), order.pose, around, at_bin, None
    known = PartStep(*about, part, grips, at_start)
    steps = list(candidates.steps)
    steps[order.step - 1] = known
    handlings = {**assembly.own, name: replace(handling, insertion=DOWN)}
    assembly = replace(assembly, own=handlings, supply=Supply())
    collector = PartCollector(cell, assembly, steps, {})
    for robot in cell.robots:
        if robot.name in order.robots:
            collector.add_places(order.step, known, robot)
    found = replace(
        candidates,
        assembly=assembly,
        steps=tuple(steps),
        paths=collector.paths,
        spares={},
    )
    for item in sorted(collector.primaries, key=lambda item: item.cost)[:_MOST]:
        chosen = plan.with_choice(StepChoice(item))
        tasks = step_tasks(found, chosen, order.step, first)
        yield replace(tasks, tasks=tuple(map(_dropped, tasks.tasks)))


def _dropped(task: Task) -> Task:
    """Return a task with the part leaving the cell, where it puts it down over the bin."""
    if task.kind != "place-down":
        return task
    (put,) = task.handlings
    gone = replace(put, holder=Handling.GONE)
    return replace(task, label=f"drop {task.object}", handlings=(put, gone))
