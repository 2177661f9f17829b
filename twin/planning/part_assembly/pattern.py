"""The pattern of a line, from the tasks of the products that were planned, and plans for all of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from planning.errors import PlanInvariantError
from planning.tasks.task import ARRIVE, LEAVE, PRESENT, Task
from planning.tasks.work import buffers_of, is_done_to_a_product
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.repetition.pattern import Pattern, numbered
from scheduling.repetition.repeat import repeat_graph
from twin.host.progress import StageWatch
from twin.planning.part_assembly.line import Line
from twin.run.policies import IN_TURNS, SHORTENED


def line_pattern(line: Line, tasks: Sequence[Task]) -> Pattern:
    """Return how the plan of some products goes on.

    Args:
        line: what was planned.
        tasks: of the plan, in order.
    """
    steps = len(line.section.steps) // line.period
    product = np.array(
        [
            line.numbers[str(task.object)][1]
            if task.kind in (ARRIVE, PRESENT)
            else (task.step - 1) // steps + 1
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
    """Yield what waits for what in an earlier copy."""
    # A part that is put down on its way is picked again: it has left the source by then.
    picks = {t.object: t.index for t in reversed(tasks) if t.kind == "pick"}
    come: dict[str, list[int]] = {}
    arrive: dict[str, list[int]] = {}
    leave: list[int] = []
    first: list[int] = []
    for task in tasks:
        if task.kind == PRESENT:
            come.setdefault(task.robot, []).append(task.index)
            for handling in task.handlings:
                part, number = line.numbers[handling.object]
                if number > line.period:
                    own = numbered(part, number - line.period)
                    yield task.index, picks[own], 1
        elif task.kind == ARRIVE:
            arrive.setdefault(task.robot, []).append(task.index)
        elif task.kind == LEAVE:
            leave.append(task.index)
        elif leave or task.step in line.supply.elsewhere:
            continue
        elif is_done_to_a_product(task):
            first.append(task.index)
    if leave:
        yield from ((leave[-1], task, 1) for task in first)
    for conveyor, (machine, buffer) in buffers_of(line.supply).items():
        before = come.get(machine, [])
        for k, task_index in enumerate(arrive.get(conveyor, [])):
            earlier = k - 1 - buffer
            if earlier < 0:
                lag = -(earlier // len(before))
                yield before[earlier % len(before)], task_index, lag


PRODUCTS = "all products"
"""Name of the stage for progress displays."""


def repeated_plans(
    plans: Mapping[str, TemporalPlanGraph], pattern: Pattern | None, watch: StageWatch
) -> dict[str, TemporalPlanGraph]:
    """Return plans for all products, the given ones where these are that already.

    Args:
        plans: by their names in twin.run.policies, that in turns before the shortened one.
        pattern: how they go on, None where they do not.
        watch: measures the stage, which is products.

    Raises:
        PlanInvariantError: what one product is made by is in the way of the next.
    """
    if pattern is None:
        return dict(plans)
    found: dict[str, TemporalPlanGraph] = {}
    with watch.stage("products", PRODUCTS):
        for name, tpg in plans.items():
            try:
                found[name] = repeat_graph(tpg, pattern)
            except PlanInvariantError:
                # A shorter way of one product is in the way of the next; HOME never is.
                if name != SHORTENED or IN_TURNS not in found:
                    raise
                found[name] = found[IN_TURNS]
    return found
