"""The assembly work of parts, as input of task and motion planning."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace
from functools import partial
from itertools import pairwise

from planning.parts.assembly import PartAssembly, Work
from planning.parts.candidates import LazyCandidates, PartCandidates
from planning.parts.expansion import step_tasks, time_windows, waiting_tasks
from planning.parts.spares import with_spares
from planning.tasks.work import AssemblyWork
from planning.transforms import Transform


def part_work(candidates: PartCandidates) -> AssemblyWork:
    """Return the assembly work of part candidates, for assignment and motion planning."""
    passing = _passing(candidates.assembly)
    stands = {(a + 1, b + 1) for a, b in candidates.balance}
    return AssemblyWork(
        candidates.problem,
        partial(step_tasks, candidates),
        partial(waiting_tasks, candidates),
        windows=partial(time_windows, candidates.steps),
        spare=partial(_spare_work, candidates),
        moved=partial(_work_with, candidates),
        needs=frozenset(stands.union(*map(pairwise, passing.values()))),
        passing=passing,
    )


def first_work(known: LazyCandidates, count: int) -> AssemblyWork:
    """Return the assembly work of a number of first steps, see ``LazyCandidates``."""
    return part_work(known.first(count)).of_first(count)


def _spare_work(
    candidates: PartCandidates, step: int, present: Collection[str]
) -> AssemblyWork | None:
    found = with_spares(candidates, step, present)
    return None if found is None else part_work(found)


def _work_with(
    candidates: PartCandidates, starts: Mapping[str, Transform]
) -> AssemblyWork:
    """Return the work with other start poses of parts, and without spares."""
    objects = tuple(
        replace(item, start=starts.get(item.name, item.start))
        for item in candidates.cell.objects
    )
    moved = replace(candidates.cell, objects=objects)
    return part_work(LazyCandidates(moved, candidates.assembly).first(candidates.count))


def _passing(assembly: PartAssembly) -> dict[str, tuple[int, ...]]:
    """Return the steps about each part that comes from a source or is put down temporarily, from 1."""
    steps = assembly.steps
    own: dict[str, list[int]] = {}
    for number, step in enumerate(steps, start=1):
        if isinstance(step, Work):
            continue  # what is done at a part that does not move on
        own.setdefault(step.part, []).append(number)
    return {
        name: tuple(numbers)
        for name, numbers in own.items()
        if name in assembly.supply.sourced or len(numbers) > 1
    }
