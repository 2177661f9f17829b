"""Assembly work as input of the planners: expansion of its steps to tasks, and supply by machines.

The task graph (APEX-MR IV-A) has the tasks of robots, their configurations, and their dependencies. It
precedes the planning of simultaneous motion: it knows no conflicts of motions.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import islice
from typing import TYPE_CHECKING, Any

import networkx as nx
import numpy as np

from planning.tasks.assignment import AssignmentProblem, TaskPlan, alternative_choices
from planning.tasks.task import StepTasks, Task, TimeWindow
from planning.transforms import Indices, Transform

_MOST_WAYS = 12
"""Greatest number of alternatives tried for one step."""

PlacedPart = tuple[str, Transform]
"""Name of a part and where its centre lies in the world."""

ORDER, DEPENDENCY = "order", "dependency"
"""Kinds of edges: a robot does one task after another; a task waits for one of any robot."""


def _no_items(_: object) -> tuple[()]:
    return ()


def _no_spare(_: int, __: object) -> None:
    return None


@dataclass(frozen=True)
class AssemblyWork:
    """An assembly ready for assignment and planning, of any kind.

    Attributes:
        problem: the assignment problem.
        expand: returns the tasks of a step of a plan: given the plan, the step (from 1) and the
            index of its first task.
        waits: yields pairs of tasks, given those of all steps: the second waits for the first.
        windows: yields the windows of time between them, given the same.
        assembly: what is built, such as a ``LegoAssembly``, with its steps in their order; None
            where not requested.
        needs: pairs of steps (from 1): without the first, something would fall after the second, as a
            part does that is joined across a gap; what touches need not be among them.
        passing: the steps about each object that lies where others come after it, in a source or where it is
            put down on its way, by its name.
        spare: returns the work with spare objects for a step (from 1) whose own is lost, given those that lie
            where they were at the start; None where there are no others.
        moved: returns the work with parts that lie elsewhere at the start, given where, by name; None where
            that cannot be said.
    """

    problem: AssignmentProblem
    expand: Callable[[TaskPlan, int, int], StepTasks]
    waits: Callable[[Sequence[StepTasks]], Iterable[tuple[Task, Task]]] = _no_items
    assembly: Any = None
    needs: frozenset[tuple[int, int]] = frozenset()
    passing: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    windows: Callable[[Sequence[StepTasks]], Iterable[TimeWindow]] = _no_items
    spare: Callable[[int, Collection[str]], AssemblyWork | None] = _no_spare
    moved: Callable[[Mapping[str, Transform]], AssemblyWork] | None = None

    def of_first(self, count: int) -> AssemblyWork:
        """Return the work of a number of first steps, as if no others followed, in this order."""
        return replace(
            self,
            problem=self.problem.of_first(count),
            needs=frozenset(pair for pair in self.needs if max(pair) <= count),
            passing={k: own for k, own in self.passing.items() if max(own) <= count},
            spare=partial(_spare_of_first, self, count),
            moved=self.moved and partial(_moved_of_first, self, count),
        )

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


def _spare_of_first(
    work: AssemblyWork, count: int, step: int, there: Collection[str]
) -> AssemblyWork | None:
    found = work.spare(step, there)
    return None if found is None else found.of_first(count)


def _moved_of_first(
    work: AssemblyWork, count: int, starts: Mapping[str, Transform]
) -> AssemblyWork:
    assert work.moved is not None
    return work.moved(starts).of_first(count)


@dataclass(frozen=True)
class WorkAhead:
    """An ordered assembly of which only the steps to be planned are expanded.

    Attributes:
        steps: how many there are.
        first: returns the work of a number of first steps.
        wanted: how many are wanted at first; fewer than all where further products may be ordered.
        product: how many of them make a product, and are planned together; 1 where steps make none.
    """

    steps: int
    first: Callable[[int], AssemblyWork]
    wanted: int
    product: int = 1

    def whole(self, count: int) -> int:
        """Return a number of first steps, extended by those planned together with the last of them."""
        return min(-(-count // self.product) * self.product, self.steps)

    def made_of(self, steps: Iterable[int]) -> int:
        """Return the number of products of some steps, from 1."""
        return len({(step - 1) // self.product for step in steps})


@dataclass
class StepExpansions:
    """Expands steps in order, and offers alternatives when motion planning fails.

    Attributes:
        work: the assembly.
        plan: the choices; steps done by an alternative are updated.
    """

    work: AssemblyWork
    plan: TaskPlan

    def callables(self) -> list[Callable[[int], Iterator[StepTasks]]]:
        """Return one generator function per step, as sequential planning takes them."""
        return [partial(self.ways, choice.step) for choice in self.plan.choices]

    def ways(self, step: int, first_index: int) -> Iterator[StepTasks]:
        """Yield the expansions of a step, the planned one first; the last one taken is remembered."""
        chosen = self.plan
        yield self.work.expand(chosen, step, first_index)
        others = alternative_choices(self.work.problem, chosen, step)
        for choice in islice(others, _MOST_WAYS - 1):
            self.plan = chosen.with_choice(choice)
            yield self.work.expand(self.plan, step, first_index)


@dataclass(frozen=True)
class Refill:
    """Parts that arrive at a source once it is empty.

    Attributes:
        machine: its chain, whose task is over when they are there.
        parts: what comes up, where.
        arrivals: chain of the conveyor along which they come, None for other sources.
        buffer: parts that may wait on the conveyor, None for any number.
    """

    machine: str
    parts: tuple[PlacedPart, ...]
    arrivals: str | None = None
    buffer: int | None = None


if TYPE_CHECKING:
    TaskGraph = nx.DiGraph[int]
else:
    TaskGraph = nx.DiGraph


def task_graph(tasks: Iterable[Task], dependencies: Indices) -> TaskGraph:
    """Return the task graph of tasks.

    Nodes are the indices of tasks, with the ``task``, and as ``target`` the configuration at which its
    robot ends it, shape (n,), None of a task without a path. An edge from a to b says that a must be
    complete before b starts; its ``kind`` is ORDER or DEPENDENCY, the latter where it is both.

    Args:
        tasks: in the order in which robots do theirs.
        dependencies: pairs (a, b) of indices: a must be complete before b starts, shape (e, 2).
    """
    graph: TaskGraph = nx.DiGraph()
    last: dict[str, int] = {}
    for task in tasks:
        target = task.path[-1] if len(task.path) else None
        graph.add_node(task.index, task=task, target=target)
        if task.robot in last:
            graph.add_edge(last[task.robot], task.index, kind=ORDER)
        last[task.robot] = task.index
    for first, second in np.asarray(dependencies).reshape(-1, 2).tolist():
        graph.add_edge(first, second, kind=DEPENDENCY)
    return graph
