"""What waits for what between the steps of an assembly of parts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from planning.parts.part_steps import PartStep, WorkStep
from planning.statics.build_order import Waits
from planning.tasks.task import HOLD, TRANSIT, StepTasks, Task

_PICK, _PLACE = "pick", "place-down"


def waiting_tasks(
    handled: Sequence[PartStep | WorkStep], balance: Waits, steps: Sequence[StepTasks]
) -> Iterator[tuple[Task, Task]]:
    """Yield what waits for what.

    A part is placed after those that it touches in its place, and picked after those that it
    touched in the stock and that were placed before it. A process, and who holds a part, wait
    for the parts concerned to be in their places, and a part is picked after what was done to it
    before. Steps wait for those that they are to come ``after``, and for those without which
    something would fall. Others need not wait for each other: what else must be kept in order
    follows from collisions.

    Args:
        handled: the steps with what touches what.
        balance: pairs of steps, from 0, of which the second changes the structure after the
            first.
        steps: the tasks of each of them.
    """
    contacts = _stock_contacts(handled)
    picked: dict[str, Task] = {}
    placed: dict[str, Task] = {}
    used: dict[str, list[Task]] = {}
    done: dict[str, Task] = {}
    changes = [_begin_and_end(*pair)[1] for pair in zip(handled, steps, strict=True)]
    yield from ((changes[a], changes[b]) for a, b in sorted(balance))
    for step, tasks in zip(handled, steps, strict=True):
        begins, ends = _begin_and_end(step, tasks)
        for name in step.step.after:
            if name in done:
                yield done[name], begins
        for task in _holds(tasks):
            assert step.held is not None
            part = step.held.part.name
            if part in placed:
                yield placed[part], task
            used.setdefault(part, []).append(task)
        if isinstance(step, WorkStep):
            for name in sorted(step.touched & placed.keys()):
                yield placed[name], begins
            for name in sorted(step.touched & step.around.keys()):
                used.setdefault(name, []).append(ends)
        else:
            part = step.part.name
            pick = next(task for task in tasks.tasks if task.kind == _PICK)
            for earlier in used.pop(part, ()):
                yield earlier, pick
            yield from ((picked[k], pick) for k in contacts[part] if k in picked)
            yield from ((placed[k], ends) for k in step.at_goal if k in placed)
            picked[part], placed[part] = pick, ends
        if step.step.name is not None:
            done[step.step.name] = ends


def _begin_and_end(step: PartStep | WorkStep, tasks: StepTasks) -> tuple[Task, Task]:
    """Return the tasks with which the work of a step begins and is complete."""
    if isinstance(step, PartStep):
        # The last one: before that the part may have been laid down in between.
        *_, place = (task for task in tasks.tasks if task.kind == _PLACE)
        return place, place
    (process,) = (t for t in tasks.tasks if t.kind == step.step.process.name)
    own = [t for t in tasks.tasks if t.robot == process.robot and t.kind != TRANSIT]
    return own[0], process


def _holds(tasks: StepTasks) -> Iterator[Task]:
    return (task for task in tasks.tasks if task.kind == HOLD)


def _stock_contacts(
    steps: Sequence[PartStep | WorkStep],
) -> Mapping[str, frozenset[str]]:
    """Return what each part touches at the start, whichever of the two is picked first."""
    placing = [step for step in steps if isinstance(step, PartStep)]
    parts = [step.part.name for step in placing]
    touched = {
        step.part.name: {other for other in step.at_start if other in parts}
        for step in placing
    }
    return {
        name: frozenset(touched[name] | {k for k in parts if name in touched[k]})
        for name in parts
    }
