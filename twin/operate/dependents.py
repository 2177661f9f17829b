"""Which steps nobody can do any more, and which rest on which: what is given up with one."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from planning.cell.workcell import Workcell
from planning.tasks.assignment import AssignmentProblem, TaskPlan
from planning.tasks.task import TRANSIT, AllowedContact, Task
from planning.tasks.work import AssemblyWork
from planning.worlds.onward import Situation, narrowed


def resting_steps(
    tasks: Iterable[Task],
    allowed: Iterable[AllowedContact],
    chosen: TaskPlan,
    needs: Iterable[tuple[int, int]],
) -> Mapping[int, frozenset[int]]:
    """Return the later steps that cannot be without a step, by number.

    In them something touches its object where that is put, or would fall without it.

    Args:
        tasks: of a plan.
        allowed: what may touch in them.
        chosen: objects of steps that are not done are those of their choices.
        needs: what would fall, see ``AssemblyWork``.
    """
    tasks = tuple(tasks)
    placed = {choice.object: choice.step for choice in chosen.choices}
    placed.update((name, step) for step, name in chosen.taken.items())
    for task in tasks:
        if task.kind in ("place-down", "place-up") and task.object is not None:
            placed[task.object] = task.step
    step_of = {task.index: task.step for task in tasks}
    works = {t.index for t in tasks if t.kind not in (TRANSIT, "pick", "handover")}
    found: dict[int, set[int]] = {}
    for first, later in needs:
        found.setdefault(first, set()).add(later)
    for contact in allowed:
        for name in (contact.first, contact.second):
            step = placed.get(name)
            if step is not None:
                touch = {step_of[t] for t in contact.tasks & works}
                found.setdefault(step, set()).update(k for k in touch if k > step)
    return {step: frozenset(own) for step, own in found.items()}


def hopeless(
    work: AssemblyWork, now: Situation, cell: Workcell
) -> tuple[AssemblyWork, dict[int, str]]:
    """Return the work with spare objects where others are lost, and the steps that nobody can do any more.

    Args:
        work: all candidates up to now.
        now: what has become of the plan.
        cell: its objects, where they were at the start.

    Returns:
        The work, and the reason by the number of the step.
    """
    while True:
        left = narrowed(work.problem, now.kept, now.world.out, {})
        steps = [step for step in left.impossible if step not in now.kept]
        before = work
        for step in steps:
            own = work.problem.primaries_of.get(step, ())
            if all(work.problem.primaries[k].object in now.world.out for k in own):
                work = work.spare(step, _untouched(now, cell)) or work
        if work is before:
            return work, {
                step: _lost_or_out(work.problem, step, now) or left.lacking(step) or ""
                for step in steps
            }


def _untouched(now: Situation, cell: Workcell) -> set[str]:
    """Return the objects that lie where they were at the start and that nobody has chosen."""
    lie = {
        name: at.pose
        for name, at in now.world.state.attachments.items()
        if at.holder is None and name not in now.world.out
    }
    items = (item for item in cell.objects if item.name in lie)
    there = {i.name for i in items if np.allclose(lie[i.name], i.start)}
    return there - {choice.object for choice in now.kept.values()}


def _lost_or_out(problem: AssignmentProblem, step: int, now: Situation) -> str:
    """Return in words what a step lacks where that is the only thing that could do it, else nothing."""
    own = [problem.primaries[k] for k in problem.primaries_of.get(step, ())]
    for names, words in (
        ({item.object for item in own}, "is lost"),
        ({item.robot for item in own}, "is out"),
    ):
        if len(names) == 1 and names <= now.world.out:
            return f"{names.pop()} {words}"
    return ""
