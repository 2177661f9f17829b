"""Repetition pattern of a production line: tasks and dependencies of a few products, copied for all other products.

The pattern is derived from the tasks of the first products, which are planned.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from planning.parts.work_in_progress import waits_in_progress
from planning.tasks.task import Task, TaskKind, changed_tools, is_product_task
from scheduling.sequences.copies import Pattern, product_part_name
from twin.kinds.parts.line import Line


def line_pattern(line: Line, tasks: Sequence[Task]) -> Pattern:
    """Return the repetition pattern of a line's plan, from its tasks in order."""
    # What is brought for the next copy comes if there is one, whichever of its products needs it first.
    product = np.array(
        [
            min(line.numbers[str(task.object)][1], line.period + 1)
            if task.kind in (TaskKind.ARRIVE, TaskKind.PRESENT)
            else line.origins[task.step - 1][0]
            for task in tasks
        ],
        dtype=np.int64,
    )
    lags = sorted(set(_lags(line, tasks)))
    return Pattern(
        line.products,
        line.period,
        product,
        np.array(lags, dtype=np.int64).reshape(-1, 3),
        line.numbers,
    )


def _lags(line: Line, tasks: Sequence[Task]) -> Iterator[tuple[int, int, int]]:
    """Yield dependencies on earlier copies of the pattern."""
    # A part that is put down on its way is picked again: it has left the source by then.
    picks = {t.object: t.index for t in reversed(tasks) if t.kind == "pick"}
    come: dict[str, list[int]] = {}
    arrive: dict[str, list[int]] = {}
    leave: list[int] = []
    first: list[int] = []
    tools = changed_tools(tasks)
    for task in tasks:
        if task.kind == TaskKind.PRESENT:
            come.setdefault(task.robot, []).append(task.index)
            for handling in task.handlings:
                part, number = line.numbers[handling.object]
                if number > line.period:
                    own = product_part_name(part, number - line.period)
                    yield task.index, picks[own], 1
        elif task.kind == TaskKind.ARRIVE:
            arrive.setdefault(task.robot, []).append(task.index)
        elif task.kind == TaskKind.LEAVE:
            leave.append(task.index)
        elif leave or task.step in line.supply.elsewhere:
            continue
        elif is_product_task(task, tools):
            first.append(task.index)
    if leave:
        yield from ((leave[-1], task, 1) for task in first)
    for a, b, copies in waits_in_progress(line.supply, tasks, line.period):
        if copies:
            yield a.index, b.index, copies
    for conveyor, (machine, buffer) in line.supply.buffers.items():
        before = come.get(machine, [])
        for k, task_index in enumerate(arrive.get(conveyor, [])):
            earlier = k - 1 - buffer
            if earlier < 0:
                lag = -(earlier // len(before))
                yield before[earlier % len(before)], task_index, lag
