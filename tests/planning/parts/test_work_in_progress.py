"""Products in progress, in random patterns that are repeated and executed with random durations."""

from collections import defaultdict

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from planning.parts.supply import Supply
from planning.parts.work_in_progress import waits_in_progress
from planning.tasks.task import STILL, Task, TaskKind, is_work

KINDS = ("pick", "place-down", "screw", TaskKind.STRAIGHT, TaskKind.TRANSIT)
CHANGE = (TaskKind.TAKE_TOOL, "driver")
STEPS, ROBOTS, TOOLS = 3, ("left", "right", "mill"), ("driver",)

Interval = tuple[float, float]


@st.composite
def patterns(draw: st.DrawFn) -> tuple[list[Task], int]:
    """Return the tasks of a pattern in their order, and the number of its products."""
    period = draw(st.integers(1, 3))
    done = st.tuples(
        st.sampled_from(ROBOTS),
        st.sampled_from(KINDS),
        st.sampled_from((None, "part", "driver")),
    )
    tasks: list[Task] = []
    for step in range(1, STEPS * period + 1):
        # Something is done in every step.
        first = draw(st.sampled_from(ROBOTS)), "place-down", "part"
        change = ROBOTS[0], *CHANGE
        for robot, kind, item in [change, *draw(st.lists(done, max_size=3)), first]:
            tasks.append(Task(len(tasks), robot, kind, step, "", STILL, (), item))
    return tasks, period


def executed(
    tasks: list[Task], period: int, copies: int, bound: int | None, seed: int
) -> dict[int, list[Interval]]:
    """Return when somebody works for each product, each robot as early as it can."""
    products = tuple(k // STEPS + 1 for k in range(STEPS * period))
    supply = Supply(in_progress=bound, products=products)
    waits: dict[tuple[int, int], list[tuple[int, int]]] = defaultdict(list)
    within = waits_in_progress(supply, tasks)
    across = [w for w in waits_in_progress(supply, tasks, period) if w[2]]
    for a, b, lag in (*within, *across):
        for copy in range(copies - lag):
            waits[copy + lag, b.index].append((copy, a.index))
    rng, free = np.random.default_rng(seed), dict.fromkeys(ROBOTS, 0.0)
    end: dict[tuple[int, int], float] = {}
    found: dict[int, list[Interval]] = defaultdict(list)
    for copy in range(copies):
        for task in tasks:
            before = [end[own] for own in waits[copy, task.index]]
            start = max([free[task.robot], *before])
            free[task.robot] = end[copy, task.index] = start + rng.exponential()
            if is_work(task, TOOLS):
                product = products[task.step - 1] + copy * period
                found[product].append((start, free[task.robot]))
    return found


def most_in_progress(found: dict[int, list[Interval]]) -> int:
    """Return the greatest number of products at a time that are begun and not complete."""
    begin = {k: min(start for start, _ in own) for k, own in found.items()}
    end = {k: max(last for _, last in own) for k, own in found.items()}
    return max(
        sum(begin[k] <= at < end[k] for k in found) for at in [*begin.values(), 0.0]
    )


@settings(max_examples=40, deadline=None)
@given(patterns(), st.integers(1, 5), st.integers(0, 2**32 - 1))
def test_no_more_products_are_in_progress_than_may_be(
    drawn: tuple[list[Task], int], bound: int, seed: int
) -> None:
    tasks, period = drawn
    free = executed(tasks, period, 5, None, seed)
    found = executed(tasks, period, 5, bound, seed)
    assert most_in_progress(found) <= bound
    if most_in_progress(free) <= 1 or bound >= 5 * period:
        assert found == free
