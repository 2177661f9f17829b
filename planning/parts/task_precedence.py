"""Precedence between the tasks of consecutive steps, and the time windows between them.

A task waits for the tasks that supply its part, transport its assembly, or clear its place.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import pairwise

from planning.handling.task_history import TaskHistory
from planning.parts.assembly import MachineWork, PlacePart
from planning.parts.candidates import PartCandidates
from planning.parts.part_steps import KnownStep, PartStep
from planning.parts.spares import with_chosen_spares
from planning.parts.supply import Supply
from planning.parts.work_in_progress import waits_in_progress
from planning.tasks.task import (
    StepTasks,
    Task,
    TaskKind,
    TimeWindow,
    changed_tools,
    is_product_task,
)

_PICK, _PLACE = "pick", "place-down"
_PICKED, _PLACED, _MACHINED, _DONE = "picked", "placed", "machined", "done"
"""What was done last to a part, or which named step."""

_PASSED = "passed"
"""Which machine let the least time after a step pass."""

_STEP, _CHANGED = "step", "changed"
"""What completes a step, and the changeovers that one waits for."""

_USED, _PUT = "used", "put"
"""What was done to a part, and put to it, since it was picked last."""

_CAME, _THERE, _BUILT, _LEFT = "came", "there", "built", "left"
"""What a machine brought, and by which a part is there; what was done since a product left, and that."""


def waiting_tasks(
    candidates: PartCandidates, steps: Sequence[StepTasks]
) -> Iterator[tuple[Task, Task]]:
    """Yield the precedence pairs of the tasks of all steps.

    A part is placed after those that it touches in its place, and picked after those that it
    touched in the stock and that were placed before it. A process, and who holds a part, wait
    for the parts concerned to be in their places, and a part is picked after what was done to it
    before. A machine waits for all that was done to its part and put to it before, and all that
    is done to that part or put to it later waits for the machine. Steps wait for those that they
    are to come ``after``, and for those without which something would fall. Others need not wait
    for each other: what else must be kept in order follows from collisions.

    The pick of a part that a source supplies waits for its arrival. What leaves waits for all that was done to
    it, and whatever is done at the place of the next product for that to be gone. A product waits for an earlier
    one to be complete where the number of those in progress is bounded.
    """
    tasks_of = ((own.step, task) for own in steps for task in own.tasks)
    picked = ((step, task.object) for step, task in tasks_of if task.kind == _PICK)
    every = [task for own in steps for task in own.tasks]
    supply, tools = candidates.assembly.supply, changed_tools(every)
    known, history = with_chosen_spares(candidates, picked).steps, TaskHistory()
    done = {own.step for own in steps if _is_done(own)}
    pairs = [(known[own.step - 1], own) for own in steps if own.step in done]
    changes = {t.step - 1: _begin_and_end(k, t)[1] for k, t in pairs}
    for a, b in sorted(candidates.balance):
        if a in changes and b in changes:
            yield changes[a], changes[b]
    contacts = _stock_contacts(known)
    for tasks in steps:
        if tasks.step in done:
            step = known[tasks.step - 1]
            yield from _waits_of_step(history, contacts, step, tasks)
        yield from _waits_of_supply(history, supply, tools, tasks)
    for earlier, task, _ in waits_in_progress(supply, every):
        yield earlier, task


def _is_done(step: StepTasks) -> bool:
    """Tell whether a step is done; for one that is not, machines may continue."""
    return any(task.kind not in TaskKind.SUPPLY for task in step.tasks)


def _waits_of_supply(
    history: TaskHistory, supply: Supply, tools: Collection[str], step: StepTasks
) -> Iterator[tuple[Task, Task]]:
    """Yield the precedence pairs of machines that supply and remove parts."""
    for task in step.tasks:
        if task.kind == TaskKind.LEAVE:
            yield from history.before(task, _BUILT, "")
            history.forget(_BUILT, "")
            history.put(_LEFT, "", task)
        elif task.kind == TaskKind.CHANGEOVER:
            for own in supply.changeovers_after[task.step]:
                if (own.machine, own.part) == (task.robot, task.object):
                    yield from history.before(task, _STEP, *map(str, own.after))
                    yield from history.before(task, _LEFT, *[""] * own.left)
                    for number in own.before:
                        history.add(_CHANGED, str(number), task)
        elif task.kind == TaskKind.PRESENT:
            history.add(_CAME, task.robot, task)
            for handling in task.handlings:
                history.put(_THERE, handling.object, task)
        elif task.kind == TaskKind.ARRIVE and task.robot in supply.buffers:
            # The part that comes next waits behind the others that are still to be taken.
            machine, buffer = supply.buffers[task.robot]
            before = [first for first, _ in history.before(task, _CAME, machine)]
            if len(before) > buffer:
                yield before[-1 - buffer], task
        elif task.kind == _PICK and task.object is not None:
            yield from history.before(task, _THERE, task.object)
        if is_product_task(task, tools):
            history.add(_BUILT, "", task)
            if task.step not in supply.elsewhere:
                yield from history.before(task, _LEFT, "")


def _waits_of_step(
    history: TaskHistory,
    contacts: Mapping[str, frozenset[str]],
    step: KnownStep,
    tasks: StepTasks,
) -> Iterator[tuple[Task, Task]]:
    """Yield the predecessors of the tasks of the next step, each with the task that waits.

    Args:
        history: tasks of the steps before; those of this one are noted.
        contacts: what each part touches at the start.
        step: what is done.
        tasks: of the step.
    """
    begins, ends = _begin_and_end(step, tasks)
    history.put(_STEP, str(tasks.step), ends)
    yield from history.before(begins, _CHANGED, str(tasks.step))
    yield from history.before(begins, _DONE, *step.step.after)
    for lag in step.step.lags:
        yield from history.before(begins, _PASSED, str(lag.machine))
    for passes in (task for task in tasks.tasks if task.kind == TaskKind.LAG):
        yield ends, passes
        history.put(_PASSED, passes.robot, passes)
    yield from history.before(begins, _MACHINED, *step.touched)
    for hold in (task for task in tasks.tasks if task.kind == TaskKind.HOLD):
        assert step.held is not None
        held = step.held.part.name
        yield from history.before(hold, _PLACED, held)
        yield from history.before(hold, _MACHINED, held)
        history.add(_USED, held, hold)
    if isinstance(step, PartStep):
        part = step.part.name
        pick = next(task for task in tasks.tasks if task.kind == _PICK)
        yield from history.before(pick, _USED, part)
        history.forget(_USED, part)
        history.forget(_PUT, part)
        placed = list(history.before(pick, _PLACED, part))
        yield from placed or history.before(pick, _PICKED, *contacts[part])
        history.put(_PICKED, part, pick)
        yield from history.before(ends, _PLACED, *step.touched)
        for name in step.touched:
            history.add(_PUT, name, ends)
        history.put(_PLACED, part, ends)
    else:
        yield from history.before(begins, _PLACED, *step.touched)
        for name in step.touched.keys() & step.around.keys():
            if isinstance(step.step, MachineWork):
                yield from history.before(begins, _USED, name)
                yield from history.before(begins, _PUT, name)
                history.put(_MACHINED, name, begins)
            history.add(_USED, name, ends)
    if step.step.name is not None:
        history.put(_DONE, step.step.name, ends)


def _begin_and_end(known: KnownStep, tasks: StepTasks) -> tuple[Task, Task]:
    """Return the tasks that begin and complete the work of a step."""
    step = known.step
    if isinstance(step, PlacePart):
        # The last one: before that the part may have been laid down in between.
        *_, place = (task for task in tasks.tasks if task.kind == _PLACE)
        return place, place
    if isinstance(step, MachineWork):
        (work,) = (task for task in tasks.tasks if task.kind == step.process)
        return work, work
    pairs = pairwise(tasks.tasks)
    return next(pair for pair in pairs if pair[1].kind == step.process.name)


def time_windows(
    known: Sequence[KnownStep], steps: Sequence[StepTasks]
) -> Iterator[TimeWindow]:
    """Yield the time windows between the tasks of executed steps.

    They end where the process itself begins, or the straight motion with which a part is put down.
    """
    named: dict[str, tuple[Task, Task]] = {}
    for tasks in steps:
        if not _is_done(tasks):
            continue
        step = known[tasks.step - 1]
        begins, ends = _begin_and_end(step, tasks)
        for lag in step.step.lags:
            if lag.step in named:
                words = f"{step.step.name or step.step.words} after {lag.step}"
                begun, done = (task.index for task in named[lag.step])
                yield TimeWindow(begun, done, ends.index, lag.least, lag.most, words)
        if step.step.name is not None:
            named[step.step.name] = begins, ends


def _stock_contacts(steps: Sequence[KnownStep]) -> Mapping[str, frozenset[str]]:
    """Return the contacts of each part at the start, whichever of the two is picked first."""
    first: dict[str, Mapping[str, float]] = {}
    for step in steps:
        if isinstance(step, PartStep):
            first.setdefault(step.part.name, step.at_start)
    return {
        name: frozenset(k for k in first if k in touched or name in first[k])
        for name, touched in first.items()
    }
