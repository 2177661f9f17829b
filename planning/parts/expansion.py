"""Expansion of assignment choices to tasks and precedences: pick, place, hold, process (APEX-MR IV-A)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from planning.contacts.interference import shapes_overlap_depth
from planning.contacts.touching import standing_fixtures
from planning.grips.grip import Grip
from planning.handling.handovers import Handover
from planning.handling.placement import (
    PlannedHandover,
    PlannedPlacement,
    PlannedSkill,
    PlannedSupport,
    write_placement,
    write_release,
    write_support,
)
from planning.handling.task_history import TaskHistory
from planning.handling.tool_changes import with_tools
from planning.parts.assembly import MachineWork, PlacePart, Work
from planning.parts.candidates import PartCandidates
from planning.parts.part_skills import held_pose, process_targets
from planning.parts.part_steps import KnownStep, PartStep
from planning.parts.spares import with_chosen_spares
from planning.parts.supply import Supply
from planning.steps.skill import SkillPath, contacts_with, handled_contact, tool_entity
from planning.steps.step_writer import StepWriter
from planning.tasks.assignment import TaskPlan
from planning.tasks.task import (
    Handling,
    StepTasks,
    Task,
    TaskKind,
    TimeWindow,
    is_product_task,
)
from planning.transforms import Transform

_STRAYS = 2e-4
"""A carried part strays from its straight path by this: joints move evenly between its poses [m]."""

_PICK, _PLACE = "pick", "place-down"

_PICKED, _PLACED, _MACHINED, _DONE = "picked", "placed", "machined", "done"
"""What was done last to a part, or which named step."""

_PASSED = "passed"
"""Which machine let the least time after a step pass."""

_USED, _PUT = "used", "put"
"""What was done to a part, and put to it, since it was picked last."""

_CAME, _THERE, _BUILT, _LEFT = "came", "there", "built", "left"
"""What a machine brought, and by which a part is there; what was done since a product left, and that."""


def step_tasks(
    candidates: PartCandidates, plan: TaskPlan, step: int, first: int
) -> StepTasks:
    """Return the tasks of a step of a plan, numbered from an index on."""
    chosen = with_chosen_spares(candidates, ((c.step, c.object) for c in plan.choices))
    return _Expansion(chosen, plan, step, first).tasks()


class _Expansion:
    """A step with its choice, and its tasks.

    Args:
        candidates: of all steps.
        plan: what was chosen.
        step: counted from 1.
        first: index of its first task.
    """

    def __init__(
        self, candidates: PartCandidates, plan: TaskPlan, step: int, first: int
    ) -> None:
        self._candidates, self._plan, self._choice = candidates, plan, plan[step]
        self._known = candidates.steps[step - 1]
        self._cell = with_tools(candidates.cell, self._choice.tools)
        self._paths = candidates.paths.planned(plan, step)
        self._build = StepWriter(self._cell, step, first, actuated=True)

    def tasks(self) -> StepTasks:
        """Return the tasks of the step; tool changes come first."""
        changes, build, step = self._candidates.changes, self._build, self._known.step
        number, supply = self._choice.step, self._candidates.assembly.supply
        before = changes.mounted
        for choice in self._plan.choices[: number - 1]:
            before |= dict(choice.tools)
        if build.first == 0:
            changes.begin(build)
        for robot, tool in sorted(self._choice.tools):
            if before[robot] != tool:
                changes.change(build, robot, before[robot], tool)
        if isinstance(self._known, PartStep):
            done = write_placement(build, self._placement(self._known))
        elif isinstance(step, Work):
            done = self._process(step)
        else:
            assert isinstance(step, MachineWork)
            shut: tuple[Handling, ...] = ()
            if step.door is not None:
                shut = _shut_door_handlings(
                    step.door, self._cell.object(step.door).start
                )
            about = step.machine, step.process, step.words, step.part, shut
            done = build.machine_task(*about)
        for earlier, last in self._candidates.paths.keeps.items():
            if last == number:
                self._let_go(earlier, done)
        for lag in self._candidates.assembly.lags_after(step.name):
            words = f"{lag.least:g} s after {lag.step}"
            build.machine_task(str(lag.machine), TaskKind.LAG, words, None)
        if (leaving := supply.leaves.get(number)) is not None:
            gone = tuple(
                Handling(part, 1, Handling.GONE, pose) for part, pose in leaving.parts
            )
            build.machine_task(leaving.machine, TaskKind.LEAVE, "leaves", None, gone)
        changes.allow_mounted(build, before)
        return self._with_depths(build.build())

    def _with_depths(self, tasks: StepTasks) -> StepTasks:
        """Return tasks with the penetration depths allowed to a part in its place and along its insertion."""
        known = self._known
        if not isinstance(known, PartStep):
            return tasks
        part, placed = known.part, standing_fixtures(self._cell) | known.others
        handling = self._candidates.assembly.handling(part.name)
        straight = (
            (known.place, np.array(handling.insertion), handling.approach),
            (part.start, -np.array(handling.extraction), handling.leave),
        )
        allowed = []
        for contact in tasks.allowed:
            (*_, other) = {contact.first, contact.second} - {part.name}
            if part.name in (contact.first, contact.second) and other in placed:
                item = part, part.start
                deep = shapes_overlap_depth(item, placed[other], straight)
                contact = replace(contact, depth=round(deep + _STRAYS, 6))
            allowed.append(contact)
        return replace(tasks, allowed=tuple(allowed))

    def _placement(self, step: PartStep) -> PlannedPlacement:
        """Return the pick, handover, hold and place of the part."""
        choice, part, paths = self._choice, step.part.name, self._candidates.paths
        *_, pick, place = self._paths
        kept = choice.step in paths.keeps
        if kept:
            place = replace(place, path=place.path[: place.change_at])
        relay = paths.relays.get(choice.primary)
        between: tuple[PlannedSkill, PlannedSkill] | PlannedHandover | None = None
        if relay is None:
            first = self._pick(part, pick, step.grips[choice.grasp], step.at_start)
        else:
            first = self._pick(part, relay.give.path, relay.give.grip, step.at_start)
            rest = relay.between
            if isinstance(rest, Handover):
                in_hand = self._in_hand(place.robot, relay.take.grip)
                between = PlannedHandover(rest, in_hand, by_home=True)
            else:
                coming = f"{part} to where it lies in between"
                contacts = contacts_with(part, rest.touched)
                laid, _ = relay.passing
                down = laid, coming, f"lay down {part}", rest.pose, contacts
                again = self._pick(part, pick, relay.take.grip, rest.touched)
                between = PlannedSkill(*down), again
        refill = self._candidates.assembly.supply.refills.get(choice.step)
        contacts = contacts_with(part, step.touched)
        coming, words = f"{part} to its place", f"place {part}"
        put = PlannedSkill(place, coming, words, step.place, contacts)
        return PlannedPlacement(
            part, replace(first, refill=refill), between, put, self._hold(), kept=kept
        )

    def _hold(self) -> PlannedSupport | None:
        """Return the grip of another robot on a part held meanwhile, None if nothing is."""
        path = self._candidates.paths.planned_hold(self._plan, self._choice.step)
        if path is None or self._known.held is None:
            return None
        part = self._known.held.part.name
        grips = PlannedSkill(path, f"to hold {part}", f"hold {part}")
        touched = handled_contact(self._cell.robot(path.robot), part)
        return PlannedSupport(grips, part, f"let go of {part}", touched)

    def _pick(
        self, part: str, path: SkillPath, grip: Grip, touched: Iterable[str]
    ) -> PlannedSkill:
        in_hand = self._in_hand(path.robot, grip)
        contacts = contacts_with(part, touched)
        return PlannedSkill(path, f"to {part}", f"pick {part}", in_hand, contacts)

    def _in_hand(self, robot: str, grip: Grip) -> Transform:
        """Return the pose of a gripped part in the flange frame of its robot."""
        frame = self._candidates.assembly.frame
        return held_pose(self._cell.robot(robot), frame, grip.pose)

    def _process(self, step: Work) -> int:
        """Write the hold if any, approach, process, and retreats; return the process."""
        build, known, words = self._build, self._known, step.words
        robot, owner = self._cell.robot(self._choice.robot), step.spot.owner
        part = owner if owner in known.around else None
        turn = step.process.turns[self._choice.grasp]
        targets = process_targets(step.process, known.place, turn)
        first, last = targets.first, targets.last
        (path,) = self._paths
        waypoints = np.vstack([path.lead, path.path])
        hold = self._hold()
        held = 0 if hold is None else write_support(build, hold)
        build.lead_in(path, f"to {words}")
        begun, done, back = (
            # A process may stay where it is.
            build.skill(
                SkillPath(
                    kind,
                    robot.name,
                    waypoints[begin : begin + 1],
                    waypoints[min(begin + 1, end) : end + 1],
                ),
                label,
                part,
            )
            for kind, begin, end, label in (
                (TaskKind.STRAIGHT, 0, first, f"approach to {words}"),
                (step.process.name, first, last, words),
                (TaskKind.STRAIGHT, last, len(waypoints) - 1, f"back from {words}"),
            )
        )
        build.allow(contacts_with(tool_entity(robot), known.touched), begun, done, back)
        build.home(robot.name)
        if hold is not None:
            write_release(build, hold, held, begun, done)
        return done

    def _let_go(self, step: int, done: int) -> None:
        """Write the retreat of the robot that held a part placed in an earlier step, after a task."""
        choice, paths = self._plan[step], self._candidates.paths
        back = paths.release(paths.planned(self._plan, step)[-1])
        cell = with_tools(self._candidates.cell, choice.tools)
        build, label = replace(self._build, cell=cell), f"let go of {choice.object}"
        index = build.skill(back, label, choice.object, lets_go=True)
        build.home(choice.robot)
        build.depend(done, index)
        build.allow(handled_contact(cell.robot(choice.robot), choice.object), index)


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

    A pick waits for the part to be there, if it comes up. What leaves waits for all that was done to
    it, and whatever is done at the place of the next product for that to be gone.
    """
    tasks_of = ((own.step, task) for own in steps for task in own.tasks)
    picked = ((step, task.object) for step, task in tasks_of if task.kind == _PICK)
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
        yield from _waits_of_supply(history, candidates.assembly.supply, tasks)


def _is_done(step: StepTasks) -> bool:
    """Tell whether a step is done; for one that is not, machines may continue."""
    return any(task.kind not in TaskKind.SUPPLY for task in step.tasks)


def _waits_of_supply(
    history: TaskHistory, supply: Supply, step: StepTasks
) -> Iterator[tuple[Task, Task]]:
    """Yield the precedence pairs of machines that supply and remove parts."""
    for task in step.tasks:
        if task.kind == TaskKind.LEAVE:
            yield from history.before(task, _BUILT, "")
            history.forget(_BUILT, "")
            history.put(_LEFT, "", task)
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
        if is_product_task(task):
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


def _shut_door_handlings(door: str, pose: Transform) -> tuple[Handling, Handling]:
    """Return the handlings by which a door appears when a task begins, and is gone at its end.

    So no robot may be there for as long as the task may last, and it rests nowhere in between.
    """
    return Handling(door, 0, None, pose), Handling(door, 1, Handling.GONE, pose)
