"""From choices to tasks, and what waits for what: pick, carry over HOME, place, or a process (APEX-MR IV-A)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np

from planning.parts.assembly import Grip
from planning.parts.candidates import PartCandidates
from planning.parts.part_skills import held_pose, process_targets
from planning.parts.part_steps import KnownStep, MachineStep, PartStep, WorkStep
from planning.statics.build_order import Waits
from planning.steps.handovers import Handover
from planning.steps.skill import SkillPath, handled, tool_entity, touching
from planning.steps.step_writer import (
    PlannedHandover,
    PlannedPlacement,
    PlannedSkill,
    PlannedSupport,
    StepWriter,
    write_placement,
    write_release,
    write_support,
)
from planning.steps.tool_changes import with_tools
from planning.tasks.assignment import TaskPlan
from planning.tasks.task import HOLD, STRAIGHT, Handling, StepTasks, Task, door_shut
from planning.tasks.work import AssemblyWork, TaskHistory
from planning.transforms import Transform

_PICK, _PLACE = "pick", "place-down"

_PICKED, _PLACED, _MACHINED, _DONE = "picked", "placed", "machined", "done"
"""What was done last to a part, or which named step."""

_USED, _PUT = "used", "put"
"""What was done to a part, and put to it, since it was picked last."""


def part_work(candidates: PartCandidates) -> AssemblyWork:
    """Return the assembly work of part candidates, for assignment and motion planning."""
    return AssemblyWork(
        candidates.problem,
        partial(_expand_step, candidates),
        partial(_waiting_tasks, candidates.steps, candidates.balance),
    )


def _expand_step(
    candidates: PartCandidates, plan: TaskPlan, step: int, first_index: int
) -> StepTasks:
    """Return the tasks of a step as the plan chooses it.

    Tools are changed before anything else.
    """
    changes, known = candidates.changes, candidates.steps[step - 1]
    chosen = _ChosenPartStep(candidates, plan, step)
    build = StepWriter(chosen.cell, step, first_index)
    before = changes.mounted_before(plan.choices[: step - 1])
    if first_index == 0:
        changes.begin(build)
    for robot, tool in sorted(plan[step].tools):
        if before[robot] != tool:
            changes.change(build, robot, before[robot], tool)
    if isinstance(known, MachineStep):
        done = _write_machine_work(build, candidates, known)
    elif isinstance(known, PartStep):
        done = write_placement(build, chosen.placement(known))
    else:
        done = _write_process(build, chosen, known)
    for earlier, last in candidates.paths.keeps.items():
        if last == step:
            _write_let_go(build, candidates, plan, earlier, done)
    changes.allow_mounted(build, before)
    return build.build()


class _ChosenPartStep:
    """A step as a plan does it."""

    def __init__(self, candidates: PartCandidates, plan: TaskPlan, step: int) -> None:
        self.choice, self._candidates = plan[step], candidates
        self.cell = with_tools(candidates.cell, self.choice.tools)
        self.paths = candidates.paths.planned(plan, step)
        self._hold = candidates.paths.planned_hold(plan, step)

    def placement(self, step: PartStep) -> PlannedPlacement:
        """Return how the part is picked, changes hands, is held and placed."""
        choice, part = self.choice, self.choice.object
        ways = self._candidates.paths
        *_, pick, place = self.paths
        kept = choice.step in ways.keeps
        if kept:
            place = replace(place, path=place.path[: place.change_at])
        relay = ways.relays.get(choice.primary)
        between: tuple[PlannedSkill, PlannedSkill] | PlannedHandover | None = None
        if relay is None:
            first = self._pick(part, pick, step.grips[choice.grasp], step.at_start)
        else:
            first = self._pick(part, relay.paths[0], relay.give, step.at_start)
            rest = relay.between
            if isinstance(rest, Handover):
                in_hand = self._in_hand(relay.receiver, relay.take)
                between = PlannedHandover(rest, in_hand, by_home=True)
            else:
                coming = f"{part} to where it lies in between"
                contacts = touching(part, rest.touched)
                down = relay.paths[1], coming, f"lay down {part}", rest.pose, contacts
                again = self._pick(part, pick, relay.take, rest.touched)
                between = PlannedSkill(*down), again
        contacts = touching(part, step.at_goal)
        coming, words = f"{part} to its place", f"place {part}"
        put = PlannedSkill(place, coming, words, step.goal, contacts)
        return PlannedPlacement(part, first, between, put, self.hold(step), kept=kept)

    def hold(self, step: PartStep | WorkStep) -> PlannedSupport | None:
        """Return how another robot grips what is held meanwhile, None if nothing is."""
        path = self._hold
        if path is None or step.held is None:
            return None
        part = step.held.part.name
        grips = PlannedSkill(path, f"to hold {part}", f"hold {part}")
        touched = handled(self.cell.robot(path.robot), part)
        return PlannedSupport(grips, part, f"let go of {part}", touched)

    def _pick(
        self, part: str, path: SkillPath, grip: Grip, touched: Iterable[str]
    ) -> PlannedSkill:
        in_hand = self._in_hand(path.robot, grip)
        contacts = touching(part, touched)
        return PlannedSkill(path, f"to {part}", f"pick {part}", in_hand, contacts)

    def _in_hand(self, robot: str, grip: Grip) -> Transform:
        """Return the pose of the part in the flange frame of the robot that holds it by a grip."""
        return held_pose(self.cell.robot(robot), self._candidates.frame, grip.pose)


def _write_process(build: StepWriter, chosen: _ChosenPartStep, step: WorkStep) -> int:
    """Write the hold if any, approach, process, and the ways back; return the process."""
    process, robot = step.step.process, chosen.cell.robot(chosen.choice.robot)
    (path,) = chosen.paths
    words, part = step.step.words, step.step.owner
    if part not in step.around:
        part = None
    targets = process_targets(process, step.place, process.turns[chosen.choice.grasp])
    way, first, last = [*path.lead, *path.path], targets.first, targets.last
    hold = chosen.hold(step)
    held = 0 if hold is None else write_support(build, hold)
    build.lead_in(path, f"to {words}", None)
    parts = (
        (STRAIGHT, way[: first + 1], f"approach to {words}"),
        (process.name, way[first : last + 1], words),
        (STRAIGHT, way[last:], f"back from {words}"),
    )
    begun, done, back = (
        # A process may stay where it is.
        build.skill(
            SkillPath(kind, robot.name, np.array(own[:1]), np.array(own[1:] or own)),
            label,
            part,
        )
        for kind, own, label in parts
    )
    build.allow(touching(tool_entity(robot), step.touched), begun, done, back)
    build.home(robot.name)
    if hold is not None:
        write_release(build, hold, held, begun, done)
    return done


def _write_machine_work(
    build: StepWriter, candidates: PartCandidates, step: MachineStep
) -> int:
    """Write what a machine does, with its door shut; return that task."""
    work = step.step
    shut: tuple[Handling, ...] = ()
    if work.door is not None:
        shut = door_shut(work.door, candidates.cell.object(work.door).start)
    return build.unmoved(work.machine, work.process, work.words, work.part, shut)


def _write_let_go(
    build: StepWriter, candidates: PartCandidates, plan: TaskPlan, step: int, done: int
) -> None:
    """Write the way back of who kept hold of what it placed in an earlier step, after a task."""
    choice, paths = plan[step], candidates.paths
    *_, place = paths.planned(plan, step)
    back = build.skill(
        paths.release(place), f"let go of {choice.object}", choice.object
    )
    build.home(choice.robot)
    build.depend(done, back)
    robot = with_tools(candidates.cell, choice.tools).robot(choice.robot)
    build.allow(handled(robot, choice.object), back)


def _waiting_tasks(
    handled: Sequence[KnownStep], balance: Waits, steps: Sequence[StepTasks]
) -> Iterator[tuple[Task, Task]]:
    """Yield what waits for what.

    A part is placed after those that it touches in its place, and picked after those that it
    touched in the stock and that were placed before it. A process, and who holds a part, wait
    for the parts concerned to be in their places, and a part is picked after what was done to it
    before. A machine waits for all that was done to its part and put to it before, and all that
    is done to that part or put to it later waits for the machine. Steps wait for those that they
    are to come ``after``, and for those without which something would fall. Others need not wait
    for each other: what else must be kept in order follows from collisions.

    Args:
        handled: the steps with what touches what.
        balance: pairs of steps, from 0, of which the second changes the structure after the
            first.
        steps: the tasks of each of them.
    """
    changes = [_begin_and_end(*pair)[1] for pair in zip(handled, steps, strict=True)]
    yield from ((changes[a], changes[b]) for a, b in sorted(balance))
    history, contacts = TaskHistory(), _stock_contacts(handled)
    for step, tasks in zip(handled, steps, strict=True):
        yield from _waits_of_step(history, contacts, step, tasks)


def _waits_of_step(
    history: TaskHistory,
    contacts: Mapping[str, frozenset[str]],
    step: KnownStep,
    tasks: StepTasks,
) -> Iterator[tuple[Task, Task]]:
    """Yield what the tasks of the next step wait for, each with the one that waits.

    Args:
        history: tasks of the steps before; those of this one are noted.
        contacts: what each part touches at the start.
        step: what is done.
        tasks: of the step.
    """
    begins, ends = _begin_and_end(step, tasks)
    yield from history.before(begins, _DONE, *step.step.after)
    yield from history.before(begins, _MACHINED, *_concerned(step))
    for hold in (task for task in tasks.tasks if task.kind == HOLD):
        assert step.held is not None
        held = step.held.part.name
        yield from history.before(hold, _PLACED, held)
        yield from history.before(hold, _MACHINED, held)
        history.add(_USED, held, hold)
    if isinstance(step, MachineStep):
        part = step.step.part
        for did in (_PLACED, _USED, _PUT):
            yield from history.before(begins, did, part)
        history.put(_MACHINED, part, begins)
        history.add(_USED, part, begins)
    elif isinstance(step, WorkStep):
        yield from history.before(begins, _PLACED, *step.touched)
        for name in step.touched & step.around.keys():
            history.add(_USED, name, ends)
    else:
        part = step.part.name
        pick = next(task for task in tasks.tasks if task.kind == _PICK)
        yield from history.before(pick, _USED, part)
        history.forget(_USED, part)
        history.forget(_PUT, part)
        placed = list(history.before(pick, _PLACED, part))
        yield from placed or history.before(pick, _PICKED, *contacts[part])
        history.put(_PICKED, part, pick)
        yield from history.before(ends, _PLACED, *step.at_goal)
        for name in step.at_goal:
            history.add(_PUT, name, ends)
        history.put(_PLACED, part, ends)
    if step.step.name is not None:
        history.put(_DONE, step.step.name, ends)


def _concerned(step: KnownStep) -> frozenset[str]:
    """Return the parts that a step is done to or puts something to; who is picked waits anyway."""
    touched = step.at_goal if isinstance(step, PartStep) else step.touched
    return frozenset(touched)


def _begin_and_end(step: KnownStep, tasks: StepTasks) -> tuple[Task, Task]:
    """Return the tasks with which the work of a step begins and is complete."""
    if isinstance(step, MachineStep):
        (work,) = (t for t in tasks.tasks if t.kind == step.step.process)
        return work, work
    if isinstance(step, PartStep):
        # The last one: before that the part may have been laid down in between.
        *_, place = (task for task in tasks.tasks if task.kind == _PLACE)
        return place, place
    before, process = next(
        (before, task)
        for before, task in pairwise(tasks.tasks)
        if task.kind == step.step.process.name
    )
    return before, process


def _stock_contacts(
    steps: Sequence[KnownStep],
) -> Mapping[str, frozenset[str]]:
    """Return what each part touches at the start, whichever of the two is picked first."""
    first: dict[str, PartStep] = {}
    for step in steps:
        if isinstance(step, PartStep):
            first.setdefault(step.part.name, step)
    parts = tuple(first)
    touched = {
        name: {other for other in step.at_start if other in parts}
        for name, step in first.items()
    }
    return {
        name: frozenset(touched[name] | {k for k in parts if name in touched[k]})
        for name in parts
    }
