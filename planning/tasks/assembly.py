"""Assemblies as input of the planners: candidates of each step, and the tasks of the chosen candidates."""

from __future__ import annotations

from abc import ABC, abstractmethod
from bisect import bisect_left, bisect_right
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from typing import Any, Self

import numpy as np

from planning.tasks.assignment import AssignmentProblem, TaskPlan, alternative_choices
from planning.tasks.task import StepTasks, Task, TimeWindow
from planning.transforms import Indices, Transform

_MOST_ALTERNATIVES = 12
"""Greatest number of choices tried for one step."""


@dataclass(frozen=True)
class Disposal:
    """Removal of a rejected part.

    Attributes:
        step: number of the step that rejected it, from 1.
        part: its name.
        pose: of the part where a robot lets go of it over a bin, in the world; None where a person takes it.
        robots: those with free hands.
    """

    step: int
    part: str
    pose: Transform | None
    robots: frozenset[str] = frozenset()


@dataclass(frozen=True)
class Assembly(ABC):
    """An assembly ready for assignment and sequential planning: all of its steps, or the first ones.

    Attributes:
        problem: the assignment problem.
        product_ends: number of the last step of each product, whose steps are planned together; empty without products.
        spare_steps: number of steps at the end that are only done if more products are ordered or others fail.
    """

    problem: AssignmentProblem
    product_ends: Sequence[int] = field(default=(), kw_only=True)
    spare_steps: int = field(default=0, kw_only=True)

    @property
    @abstractmethod
    def built(self) -> Any:
        """What is built, such as a ``LegoAssembly``, with all steps in their order."""

    @abstractmethod
    def expand(self, plan: TaskPlan, step: int, first: int) -> StepTasks:
        """Return the tasks of a step for its choice in a plan.

        Args:
            plan: the choices, those of earlier steps included.
            step: counted from 1.
            first: index of its first task.
        """

    def waits(self, steps: Sequence[StepTasks]) -> Iterable[tuple[Task, Task]]:
        """Return pairs of tasks of all steps: the second waits for the first."""
        return ()

    def windows(self, steps: Sequence[StepTasks]) -> Iterable[TimeWindow]:
        """Return the windows of time between tasks of all steps."""
        return ()

    @property
    def needs(self) -> frozenset[tuple[int, int]]:
        """Pairs of steps (from 1): if the first were left out, a part would fall after the second.

        Pairs whose parts touch may be missing; pairs that are joined across a gap are not.
        """
        return frozenset()

    @property
    def passing(self) -> Mapping[str, tuple[int, ...]]:
        """Steps (from 1) of each object at a place that other objects take after it, by its name.

        The place is a source, or one where the object is put down between two steps.
        """
        return {}

    @property
    def steps(self) -> int:
        """Number of all steps."""
        return len(self.built.steps)

    @property
    def wanted(self) -> int:
        """Number of steps from the first on that are done if nothing fails and no more products are ordered."""
        return self.steps - self.spare_steps

    def first(self, count: int) -> Self:
        """Return the assembly of a number of first steps, as if no others followed."""
        return replace(self, problem=self.problem.of_first(count))

    def with_spares(self, step: int, there: Collection[str]) -> Self | None:
        """Return the assembly with spare objects for a step whose own object is lost; None without spares.

        Args:
            step: counted from 1.
            there: objects that are still at their start poses.
        """
        return None

    def with_poses(self, starts: Mapping[str, Transform]) -> Self | None:
        """Return the assembly with other start poses of parts, by name; None where these cannot change.

        Raises:
            InfeasibleStepError: a step is infeasible then.
        """
        return None

    def is_named(self, step: int, names: Collection[str]) -> bool:
        """Return whether a step (from 1) has one of some names, which are those of each product."""
        return False

    def steps_at(self, _name: str) -> Collection[int]:
        """Return the steps (from 1) that place, hold or work at an object, without those of several at once."""
        return ()

    def disposals(
        self, order: Disposal, at: Mapping[str, Transform], plan: TaskPlan, first: int
    ) -> Iterator[StepTasks]:
        """Yield the tasks, from an index on, by which a robot drops a part into a bin, given the poses of objects at rest."""
        yield from ()

    def alternatives(
        self, step: int, plan: TaskPlan, first: int
    ) -> Iterator[tuple[TaskPlan, StepTasks]]:
        """Yield the tasks of a step for alternative choices, the planned one first.

        Args:
            step: counted from 1.
            plan: the choices.
            first: index of its first task.

        Yields:
            The plan with the choice, and the tasks that follow from it.
        """
        yield plan, self.expand(plan, step, first)
        others = alternative_choices(self.problem, plan, step)
        for choice in islice(others, _MOST_ALTERNATIVES - 1):
            other = plan.with_choice(choice)
            yield other, self.expand(other, step, first)

    def link(self, steps: Sequence[StepTasks]) -> Indices:
        """Return all dependencies between tasks, within steps and between them.

        Returns:
            Pairs (a, b) of task indices, shape (e, 2), sorted: a must be complete before b
            starts. Tasks of one robot are in order anyway.
        """
        pairs = {pair for step in steps for pair in step.dependencies}
        pairs |= {
            (a.index, b.index) for a, b in self.waits(steps) if a.robot != b.robot
        }
        return np.array(sorted(pairs), dtype=np.int64).reshape(-1, 2)

    @property
    def ends(self) -> Sequence[int]:
        """Number of the last step of each product; without products every step is one."""
        return self.product_ends or range(1, self.steps + 1)

    def steps_of_products(self, count: int) -> int:
        """Return the number of steps of a number of first products, or of all that there are."""
        return self.ends[min(count, len(self.ends)) - 1] if count > 0 else 0

    def with_whole_products(self, count: int) -> int:
        """Return a number of first steps, extended to the end of the last product."""
        return self.steps_of_products(bisect_left(self.ends, count) + 1)

    def whole_products(self, count: int) -> int:
        """Return how many products are complete after a number of first steps."""
        return bisect_right(self.ends, count)

    def count_products(self, steps: Iterable[int]) -> int:
        """Return the number of products of some steps, counted from 1."""
        return len({bisect_left(self.ends, step) for step in steps})
