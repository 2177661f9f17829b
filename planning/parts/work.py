"""An assembly of parts with its candidates, as the input of task and motion planning."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

from planning.cell.workcell import Workcell
from planning.parts.assembly import (
    AnyStep,
    MachineWork,
    PartAssembly,
    PlacePart,
    Work,
)
from planning.parts.candidates import LazyCandidates, PartCandidates
from planning.parts.disposal import disposal_tasks
from planning.parts.expansion import step_tasks
from planning.parts.spares import with_spares
from planning.parts.task_precedence import time_windows, waiting_tasks
from planning.tasks.assembly import Assembly, Disposal
from planning.tasks.assignment import TaskPlan
from planning.tasks.task import StepTasks, Task, TimeWindow
from planning.transforms import Transform


@dataclass(frozen=True)
class PartWork(Assembly):
    """An assembly of parts with its candidates, for assignment and motion planning.

    Attributes:
        candidates: of the steps of the problem at least.
        count: number of first steps that the problem is of, None for all.
        lazy: source of the candidates of first steps; None where those of all are found.
    """

    candidates: PartCandidates
    count: int | None = field(default=None, kw_only=True)
    lazy: LazyCandidates | None = field(default=None, repr=False, kw_only=True)

    @property
    def built(self) -> PartAssembly:
        """Goals and steps."""
        return self.candidates.assembly

    @property
    def needs(self) -> frozenset[tuple[int, int]]:
        """Pairs of steps: a support and what it bears, and consecutive steps about one part."""
        pairs = {(a + 1, b + 1) for a, b in self.candidates.balance}
        pairs |= set(_after_batches(self.built))
        found = frozenset(pairs.union(*map(pairwise, _passing(self.built).values())))
        if self.count is None:
            return found
        return frozenset(pair for pair in found if max(pair) <= self.count)

    @property
    def passing(self) -> Mapping[str, tuple[int, ...]]:
        """Steps of each part that comes from a source or is put down temporarily."""
        last = len(self.problem.steps)
        return {k: own for k, own in _passing(self.built).items() if max(own) <= last}

    def first(self, count: int) -> PartWork:
        """Return the assembly of a number of first steps."""
        if self.lazy is not None:
            return part_work(self.lazy.first(count)).first(count)
        return replace(super().first(count), count=count)

    def expand(self, plan: TaskPlan, step: int, first: int) -> StepTasks:
        """Return the tasks of a step."""
        return step_tasks(self.candidates, plan, step, first)

    def is_named(self, step: int, names: Collection[str]) -> bool:
        """Return whether a step has one of some names, or one of them with the number of its product."""
        known = {own.name for own in self.built.steps}
        name = self.built.steps[step - 1].name or ""
        base = name.rpartition(".")[0]
        return name in names or (base in names and base not in known)

    def steps_at(self, name: str) -> list[int]:
        """Return the steps that place, hold or work at a part, without batches."""
        steps = enumerate(self.built.steps, start=1)
        return [k for k, step in steps if name in _parts_at(step)]

    def disposals(
        self, order: Disposal, at: Mapping[str, Transform], plan: TaskPlan, first: int
    ) -> Iterator[StepTasks]:
        """Yield the tasks by which a robot drops a part into a bin."""
        return disposal_tasks(self.candidates, order, at, plan, first)

    def waits(self, steps: Sequence[StepTasks]) -> Iterator[tuple[Task, Task]]:
        """Yield the precedence pairs of steps, and those of machines."""
        return waiting_tasks(self.candidates, steps)

    def windows(self, steps: Sequence[StepTasks]) -> Iterator[TimeWindow]:
        """Yield the windows of time between tasks."""
        return time_windows(self.candidates.steps, steps)

    def with_spares(self, step: int, there: Collection[str]) -> PartWork | None:
        """Return the assembly with spare parts for a step, None where there are no others."""
        found = with_spares(self.candidates, step, there)
        return None if found is None else self._of(found)

    def with_poses(self, starts: Mapping[str, Transform]) -> PartWork:
        """Return the assembly with other start poses of parts, and without spares."""
        old = self.candidates
        objects = tuple(
            replace(item, start=starts.get(item.name, item.start))
            for item in old.cell.objects
        )
        moved = replace(old.cell, objects=objects)
        return self._of(LazyCandidates(moved, old.assembly).first(old.count))

    def _of(self, candidates: PartCandidates) -> PartWork:
        """Return the same steps with other candidates."""
        work = part_work(candidates)
        return work if self.count is None else work.first(self.count)


def part_work(candidates: PartCandidates) -> PartWork:
    """Return the assembly of part candidates, for assignment and motion planning."""
    return PartWork(candidates.problem, candidates)


def lazy_part_work(cell: Workcell, assembly: PartAssembly) -> PartWork:
    """Return an assembly whose candidates are found as ``first`` asks for steps."""
    lazy = LazyCandidates(cell, assembly)
    return replace(part_work(lazy.first(0)), lazy=lazy)


def _passing(assembly: PartAssembly) -> dict[str, tuple[int, ...]]:
    """Return the steps about each part that comes from a source or is put down temporarily, from 1."""
    steps = assembly.steps
    own: dict[str, list[int]] = {}
    for number, step in enumerate(steps, start=1):
        batch = isinstance(step, MachineWork) and len(step.parts) > 1
        if isinstance(step, Work) or batch:
            continue  # what is done at a part that does not move on, or without it
        own.setdefault(step.part, []).append(number)
    return {
        name: tuple(numbers)
        for name, numbers in own.items()
        if name in assembly.supply.sourced or len(numbers) > 1
    }


def _parts_at(step: AnyStep) -> tuple[str | None, ...]:
    """Return the parts that a step places, holds or works at; none of a batch, which is done without one of them, too."""
    if isinstance(step, Work):
        return step.spot.owner, step.hold
    if isinstance(step, MachineWork) and len(step.parts) > 1:
        return ()
    return step.part, step.hold


def _after_batches(assembly: PartAssembly) -> Iterator[tuple[int, int]]:
    """Yield batches, each with the steps that move its parts on, from 1."""
    batch: dict[str, int] = {}
    for number, step in enumerate(assembly.steps, start=1):
        if isinstance(step, MachineWork) and len(step.parts) > 1:
            batch.update(dict.fromkeys(step.parts, number))
        elif isinstance(step, PlacePart) and step.part in batch:
            yield batch.pop(step.part), number
