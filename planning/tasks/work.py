"""Assembly as the planners need it, with the expansion of its steps to tasks."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from typing import Any

import numpy as np

from planning.tasks.assignment import AssignmentProblem, TaskPlan, alternatives
from planning.tasks.task import StepTasks, Task
from planning.transforms import Indices

_MOST_WAYS = 12
"""How many ways are tried for one step."""


@dataclass(frozen=True)
class AssemblyWork:
    """An assembly ready to be assigned and planned, whatever it is made of.

    Attributes:
        problem: who can do which step with what.
        expand: returns the tasks of a step of a plan: given the plan, the step (from 1) and the
            index of its first task.
        waits: yields pairs of tasks, given those of all steps: the second waits for the first.
        assembly: what is built, such as a ``LegoAssembly``, with its steps in their order; None
            where nobody asks.
        order: of the steps, by the numbers that they had at first; empty for that order itself.
        exchanged: returns the work with a step (from 1) and the next one exchanged, None where
            that cannot be, or nothing is known of it.
    """

    problem: AssignmentProblem
    expand: Callable[[TaskPlan, int, int], StepTasks]
    waits: Callable[[Sequence[StepTasks]], Iterable[tuple[Task, Task]]] = lambda _: ()
    assembly: Any = None
    order: tuple[int, ...] = ()
    exchanged: Callable[[int], AssemblyWork | None] = lambda _: None

    def in_this_order(self) -> AssemblyWork:
        """Return the same work without any other order of its steps."""
        return replace(self, exchanged=lambda _: None)

    def link(self, steps: Sequence[StepTasks]) -> Indices:
        """Return all dependencies between tasks, those within the steps included.

        Returns:
            Pairs (a, b) of task indices, shape (e, 2), sorted: a must be complete before b
            starts. Tasks of one robot are in order anyway.
        """
        pairs = {pair for step in steps for pair in step.dependencies}
        pairs |= {
            (a.index, b.index) for a, b in self.waits(steps) if a.robot != b.robot
        }
        return np.array(sorted(pairs), dtype=np.int64).reshape(-1, 2)


@dataclass
class StepExpansions:
    """Expands steps in order, and offers other ways when motion planning fails.

    Attributes:
        work: the assembly.
        plan: the choices; steps that were done another way are updated.
    """

    work: AssemblyWork
    plan: TaskPlan

    def callables(self) -> list[Callable[[int], Iterator[StepTasks]]]:
        """Return one generator function per step, as sequential planning takes them."""
        return [partial(self.ways, choice.step) for choice in self.plan.choices]

    def ways(self, step: int, first_index: int) -> Iterator[StepTasks]:
        """Yield a step as planned, then in other ways; the last one taken is remembered."""
        chosen = self.plan
        yield self.work.expand(chosen, step, first_index)
        others = alternatives(self.work.problem, chosen, step)
        for choice in islice(others, _MOST_WAYS - 1):
            self.plan = chosen.with_choice(choice)
            yield self.work.expand(self.plan, step, first_index)
