"""Bound on the work in progress: a product is begun once an earlier one is complete."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence

from planning.parts.supply import Supply
from planning.tasks.task import Task, changed_tools, is_work


def waits_in_progress(
    supply: Supply, tasks: Sequence[Task], period: int = 0
) -> Iterator[tuple[Task, Task, int]]:
    """Yield pairs of tasks, the second of which waits for the first, as no more products may be in progress.

    What every robot or machine does first for a product waits for what each other one does last for the product
    as many before it as may be in progress.

    Args:
        supply: with the bound.
        tasks: in the order of the plan.
        period: products of the pattern that is repeated; 0 without repetition.

    Yields:
        The tasks, and by how many copies of the pattern the first is earlier.
    """
    bound, tools = supply.in_progress, changed_tools(tasks)
    if bound is None:
        return
    first: dict[tuple[int, str], Task] = {}
    last: dict[int, dict[str, Task]] = defaultdict(dict)
    for task in tasks:
        product = supply.products[task.step - 1]
        if is_work(task, tools):
            first.setdefault((product, task.robot), task)
            last[product][task.robot] = task
    for (product, robot), begins in first.items():
        earlier = product - bound
        copies = -((earlier - 1) // period) if period else 0
        for other, ends in last.get(earlier + copies * period, {}).items():
            if other != robot and (copies or ends.index < begins.index):
                yield ends, begins, copies
