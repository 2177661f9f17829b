"""From choices to tasks, and what waits for what: pick, carry over HOME, place, or a process (APEX-MR IV-A)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np

from planning.cell.workcell import PlacedRobot
from planning.parts.assembly import Grip
from planning.parts.beside import way_of
from planning.parts.candidates import PartCandidates
from planning.parts.handovers import Handover
from planning.parts.part_skills import held_pose, process_targets
from planning.parts.part_steps import KnownStep, MachineStep, PartStep, WorkStep
from planning.parts.relays import Relay
from planning.statics.build_order import Waits
from planning.steps.skill import Pairs, SkillPath, touching
from planning.steps.step_writer import StepBuilder
from planning.steps.tool_changes import tool_entity, with_tools
from planning.tasks.assignment import StepChoice, TaskPlan
from planning.tasks.task import HOLD, STRAIGHT, Handling, StepTasks, Task, door_shut
from planning.tasks.work import AssemblyWork
from planning.transforms import Array

_PICK, _PLACE = "pick", "place-down"


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

    Every transit ends at the configuration that the next skill starts from, or at HOME, where
    robots stop between pick and place and after it. Tools are changed before anything else.
    """
    build, changes = StepBuilder(step, first_index), candidates.changes
    expander = _Expander(candidates, plan, build)
    before = changes.mounted_before(plan.choices[: step - 1])
    if first_index == 0:
        changes.begin(build)
    for robot, tool in sorted(plan[step].tools):
        if before[robot] != tool:
            changes.change(build, robot, before[robot], tool)
    handled = candidates.steps[step - 1]
    if isinstance(handled, MachineStep):
        done = expander.machine_work(handled)
    elif isinstance(handled, PartStep):
        done = expander.place(handled)
    else:
        done = expander.work(handled)
    for earlier, last in candidates.ways.keeps.items():
        if last == step:
            expander.release_kept(plan[earlier], done)
    changes.allow_mounted(build, before)
    return build.build()


class _Expander:
    """Writes the tasks of one step into a builder."""

    def __init__(
        self, candidates: PartCandidates, plan: TaskPlan, build: StepBuilder
    ) -> None:
        self.candidates, self.plan, self.build = candidates, plan, build
        self.choice = plan[build.step]
        self.cell = with_tools(candidates.cell, self.choice.tools)

    def _gripped(self, robot: str, part: str) -> Pairs:
        """Return the contact of the tool that a robot has on it with a part."""
        return touching(tool_entity(self.cell.robot(robot)), [part])

    def place(self, step: PartStep) -> int:
        """Write pick, the hold if any, place, and the ways back; return the place."""
        choice, build = self.choice, self.build
        robot, part = self.cell.robot(choice.robot), choice.object
        ways = self.candidates.ways
        *_, pick, place = ways.paths_of(self.plan, choice.step)
        kept = choice.step in ways.keeps
        if kept:
            place = replace(place, path=place.path[: place.change_at])
        relay = ways.relays.get(way_of(choice.primary))
        if isinstance(relay, Handover):
            picked = self._hand_over(step, relay)
        elif relay is not None:
            laid = self._lay_down(step, relay)
            picked = self._pick(robot, part, pick, relay.take)
            build.allow(touching(part, relay.touched), picked)
            build.depend(laid, picked)
        else:
            picked = self._pick(robot, part, pick, step.grips[choice.grasp])
            build.allow(touching(part, step.at_start), picked)
        held = self._hold(step)
        build.lead_in(place, f"{part} to its place", part)
        placed = build.skill(place, f"place {part}", part, None, step.goal)
        if not kept:
            build.transit(robot.name, robot.home, "HOME", None)
        carrying = build.of_robot(robot.name, picked, placed)
        build.allow(self._gripped(robot.name, part), *carrying)
        build.allow(touching(part, step.at_goal), placed)
        if held is not None:
            self._let_go(step, held, placed, placed)
        return placed

    def release_kept(self, choice: StepChoice, done: int) -> None:
        """Write the way back of who kept hold of what it placed, after a task."""
        build, part, ways = self.build, choice.object, self.candidates.ways
        *_, place = ways.paths_of(self.plan, choice.step)
        back = build.skill(ways.let_go(place), f"let go of {part}", part)
        robot = with_tools(self.candidates.cell, choice.tools).robot(choice.robot)
        build.transit(robot.name, robot.home, "HOME", None)
        build.depend(done, back)
        build.allow(touching(tool_entity(robot), [part]), back)

    def _pick(self, robot: PlacedRobot, part: str, path: SkillPath, grip: Grip) -> int:
        """Write transit, pick and the way HOME with a part; return the pick."""
        build = self.build
        build.lead_in(path, f"to {part}", None)
        in_hand = held_pose(robot, self.candidates.frame, grip.pose)
        picked = build.skill(path, f"pick {part}", part, robot.name, in_hand)
        build.transit(robot.name, robot.home, f"HOME with {part}", part)
        return picked

    def _lay_down(self, step: PartStep, relay: Relay) -> int:
        """Write how the part is picked first and laid down in between; return the latter."""
        build, part = self.build, step.part.name
        robot = self.cell.robot(relay.giver)
        pick, down, *_ = relay.paths
        picked = self._pick(robot, part, pick, relay.give)
        build.lead_in(down, f"{part} to where it lies in between", part)
        laid = build.skill(down, f"lay down {part}", part, None, relay.rest)
        build.transit(robot.name, robot.home, "HOME", None)
        carrying = build.of_robot(robot.name, picked, laid)
        build.allow(self._gripped(robot.name, part), *carrying)
        build.allow(touching(part, step.at_start), picked)
        build.allow(touching(part, relay.touched), laid)
        return laid

    def _hand_over(self, step: PartStep, way: Handover) -> int:
        """Write pick and handover; return the task with which the receiver takes the part."""
        build, part, cell = self.build, step.part.name, self.cell
        giver, receiver = cell.robot(way.giver), cell.robot(way.receiver)
        pick, give, _ = way.paths
        picked = self._pick(giver, part, pick, way.give)
        build.transit(receiver.name, way.pre, "to the handover", None)
        ready = build.transit(receiver.name, way.receive, "ready to receive", None)
        build.lead_in(give, f"{part} to {receiver.name}", part)
        in_hand = held_pose(receiver, self.candidates.frame, way.take.pose)
        given = build.skill(give, f"hand over {part}", part, receiver.name, in_hand)
        build.depend(ready, given)
        carrying = build.of_robot(giver.name, picked, given)
        # The receiver stands at the end of its task "ready" while the part is brought.
        build.allow(self._gripped(giver.name, part), *carrying, ready)
        build.allow(touching(part, step.at_start), picked)
        build.transit(giver.name, giver.home, "HOME", None)
        taken = build.transit(receiver.name, way.pre, f"take {part}", part)
        build.depend(given, taken)
        build.allow(self._gripped(receiver.name, part), ready, given)
        build.transit(receiver.name, receiver.home, f"HOME with {part}", part)
        return taken

    def work(self, step: WorkStep) -> int:
        """Write the hold if any, approach, process, and the ways back; return the process."""
        choice, build, process = self.choice, self.build, step.step.process
        robot = self.cell.robot(choice.robot)
        (path,) = self.candidates.ways.paths_of(self.plan, choice.step)
        words, part = step.step.words, step.step.owner
        if part not in step.around:
            part = None
        targets = process_targets(process, step.place, process.turns[choice.grasp])
        way = [*path.lead, *path.path]
        held = self._hold(step)
        build.lead_in(path, f"to {words}", None)
        coming = f"approach to {words}"
        first = self._along(STRAIGHT, way[: targets.first + 1], coming, part)
        done = self._along(
            process.name, way[targets.first : targets.last + 1], words, part
        )
        back = self._along(STRAIGHT, way[targets.last :], f"back from {words}", part)
        build.allow(touching(tool_entity(robot), step.touched), first, done, back)
        build.transit(robot.name, robot.home, "HOME", None)
        if held is not None:
            self._let_go(step, held, first, done)
        return done

    def machine_work(self, step: MachineStep) -> int:
        """Write what a machine does, with its door shut; return that task."""
        work = step.step
        shut: tuple[Handling, ...] = ()
        if work.door is not None:
            pose = self.candidates.cell.object(work.door).start
            shut = door_shut(work.door, pose)
        return self.build.unmoved(
            work.machine, work.process, work.words, work.part, shut
        )

    def _along(
        self, kind: str, way: Sequence[Array], label: str, part: str | None
    ) -> int:
        """Write a motion through configurations, the first of which is where it starts."""
        rest = way[1:] or way  # a process that stays where it is
        path = SkillPath(kind, self.choice.robot, np.array(way[:1]), np.array(rest))
        return self.build.skill(path, label, part)

    def _hold(self, step: PartStep | WorkStep) -> int | None:
        """Write how another robot grips what is held; return that task, None if nothing is."""
        path = self.candidates.ways.hold_of(self.plan, self.choice.step)
        if path is None or step.held is None:
            return None
        part = step.held.part.name
        self.build.lead_in(path, f"to hold {part}", None)
        return self.build.skill(path, f"hold {part}", part)

    def _let_go(
        self, step: PartStep | WorkStep, held: int, begun: int, done: int
    ) -> None:
        """Write the way back of who holds, once the other has done its work."""
        build = self.build
        path = self.candidates.ways.hold_of(self.plan, self.choice.step)
        assert path is not None
        assert step.held is not None
        part = step.held.part.name
        way_back = SkillPath(
            STRAIGHT, path.robot, path.path[-1:], path.waypoints[-2::-1]
        )
        back = build.skill(way_back, f"let go of {part}", part)
        home = self.cell.robot(path.robot).home
        build.transit(path.robot, home, "HOME", None)
        build.depend(held, begun)
        build.depend(done, back)
        build.allow(self._gripped(path.robot, part), held, back)


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
    history = _History(_stock_contacts(handled))
    for step, tasks in zip(handled, steps, strict=True):
        yield from history.step(step, tasks)


class _History:
    """Tasks of the steps so far that later ones may have to wait for.

    Args:
        contacts: what each part touches at the start.
    """

    def __init__(self, contacts: Mapping[str, frozenset[str]]) -> None:
        self._contacts = contacts
        self._picked: dict[str, Task] = {}
        self._placed: dict[str, Task] = {}
        self._machine: dict[str, Task] = {}
        self._done: dict[str, Task] = {}
        # What was done to a part, and put to it, since it was picked last.
        self._used: dict[str, list[Task]] = {}
        self._put: dict[str, list[Task]] = {}

    def step(self, step: KnownStep, tasks: StepTasks) -> Iterator[tuple[Task, Task]]:
        """Yield what the tasks of the next step wait for, each with the one that waits."""
        begins, ends = _begin_and_end(step, tasks)
        for name in step.step.after:
            if name in self._done:
                yield self._done[name], begins
        for name in _concerned(step):
            if name in self._machine:
                yield self._machine[name], begins
        for task in tasks.tasks:
            if task.kind == HOLD:
                assert step.held is not None
                yield from self._hold(step.held.part.name, task)
        if isinstance(step, MachineStep):
            yield from self._machine_work(step.step.part, begins)
        elif isinstance(step, WorkStep):
            for name in sorted(step.touched & self._placed.keys()):
                yield self._placed[name], begins
            for name in sorted(step.touched & step.around.keys()):
                self._used.setdefault(name, []).append(ends)
        else:
            pick = next(task for task in tasks.tasks if task.kind == _PICK)
            yield from self._pick(step.part.name, pick)
            yield from self._place(step, ends)
        if step.step.name is not None:
            self._done[step.step.name] = ends

    def _hold(self, part: str, hold: Task) -> Iterator[tuple[Task, Task]]:
        if part in self._placed:
            yield self._placed[part], hold
        if part in self._machine:
            yield self._machine[part], hold
        self._used.setdefault(part, []).append(hold)

    def _machine_work(self, part: str, work: Task) -> Iterator[tuple[Task, Task]]:
        if part in self._placed:
            yield self._placed[part], work
        for earlier in (*self._used.get(part, ()), *self._put.get(part, ())):
            yield earlier, work
        self._machine[part] = work
        self._used.setdefault(part, []).append(work)

    def _pick(self, part: str, pick: Task) -> Iterator[tuple[Task, Task]]:
        yield from ((earlier, pick) for earlier in self._used.pop(part, ()))
        self._put.pop(part, None)
        if part in self._placed:
            yield self._placed[part], pick
        else:
            for name in self._contacts[part]:
                if name in self._picked:
                    yield self._picked[name], pick
        self._picked[part] = pick

    def _place(self, step: PartStep, place: Task) -> Iterator[tuple[Task, Task]]:
        for name in step.at_goal:
            if name in self._placed:
                yield self._placed[name], place
            self._put.setdefault(name, []).append(place)
        self._placed[step.part.name] = place


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
