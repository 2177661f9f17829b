"""State of a cell from which a plan begins (``World``): poses at rest, and completed tasks.

In the initial world all robots are at HOME and no task is complete. A world is derived from executed tasks, never
from planned ones. Robots and objects that are no longer usable are listed in ``out``.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from planning.cell.workcell import Attachment, Workcell, WorldState
from planning.kinematics.kinematics import frame_pose
from planning.motion.sequential import StartConfiguration
from planning.tasks.task import (
    AllowedContact,
    Handling,
    StepTasks,
    Task,
    TaskKind,
    TimeWindow,
)
from planning.transforms import Transform, read_only_copy


@dataclass(frozen=True)
class World:
    """State of a cell in the middle of an assembly.

    Attributes:
        state: all poses; things that have left the cell, or whose pose is unknown, have none.
        steps: the tasks of each step that has been planned, those that are complete included, one
            entry a step.
        past: completed tasks of steps that were then restarted, and transits HOME of no step.
        complete: indices of the tasks that are complete.
        out: robots out of service, and unusable objects.
        tasks: index of the next new task.
        ago: time since the end of the tasks that opened time windows, by their index; 0 for others [s].
    """

    state: WorldState
    steps: tuple[StepTasks, ...] = ()
    past: tuple[StepTasks, ...] = ()
    complete: frozenset[int] = frozenset()
    out: frozenset[str] = frozenset()
    tasks: int = 0
    ago: Mapping[int, float] = field(default_factory=dict)

    @property
    def beginning(self) -> StartConfiguration:
        """Initial state of a sequential plan in this world."""
        return StartConfiguration(self.state, self._last_tasks, self.tasks)

    @property
    def _last_tasks(self) -> dict[str, int]:
        """The last completed task of each robot; absent for one that did none yet."""
        last: dict[str, int] = {}
        for task in (t for step in (*self.past, *self.steps) for t in step.tasks):
            if task.index in self.complete:
                last[task.robot] = max(task.index, last.get(task.robot, -1))
        return last

    def held(self) -> Iterator[tuple[str, Attachment]]:
        """Yield the objects in hands, with their holders."""
        for name, at in self.state.attachments.items():
            if at.holder is not None:
                yield name, at

    def begun(self) -> dict[int, StepTasks]:
        """Return the steps with a completed skill or a reached goal, by number: they continue as planned.

        What is brought for one does not begin it.
        """
        return {
            step.step: step
            for step in self.steps
            if any(
                (t.kind not in (TaskKind.TRANSIT, *TaskKind.SUPPLY) or t.goal)
                and t.index in self.complete
                for t in step.tasks
            )
        }

    def done_steps(self) -> Iterator[int]:
        """Yield the steps that are done except for final transits."""
        for number, step in sorted(self.begun().items()):
            transit_kinds = (TaskKind.TRANSIT, TaskKind.STRAIGHT, *TaskKind.SUPPLY)
            skills = {t.index for t in step.tasks if t.kind not in transit_kinds}
            if skills <= self.complete:
                yield number


def picked_steps(
    begun: Mapping[int, StepTasks], complete: Collection[int]
) -> dict[int, str]:
    """Return the objects picked in begun steps, by number, given the completed tasks."""
    return {
        number: task.object
        for number, step in begun.items()
        for task in step.tasks
        if task.kind == "pick" and task.object and task.index in complete
    }


def pending_windows(
    world: World, windows: Iterable[TimeWindow]
) -> Iterator[TimeWindow]:
    """Yield the time windows whose due task is new in a world; some are already open."""
    for window in windows:
        if window.due < world.tasks:
            continue
        ago = world.ago.get(window.done, 0.0) if window.done < world.tasks else 0.0
        known = window.moved(
            lambda task: TimeWindow.EARLIER if task < world.tasks else task
        )
        yield replace(known, ago=ago)


def object_pose(cell: Workcell, state: WorldState, name: str) -> Transform:
    """Return the pose of an object in the world, in a hand or at rest."""
    at = state.attachments[name]
    if at.holder is None:
        return at.pose
    flange = frame_pose(cell.robot(at.holder), state.configurations[at.holder])
    return read_only_copy(flange @ at.pose)


@dataclass(frozen=True)
class UnfinishedStep:
    """The rest of a begun step, to be done as planned.

    Attributes:
        step: its tasks, those that are complete included.
        tasks: those that are left, in order.
        complete: indices of those that are complete. All others, of what was planned and is not done, may be
            those of other tasks by now.
        ends: whether nothing is left but transits.
    """

    step: StepTasks
    tasks: tuple[Task, ...]
    complete: frozenset[int]
    ends: bool

    @property
    def _own_indices(self) -> dict[int, int]:
        """The completed tasks, by their own indices."""
        return {index: index for index in self.complete}

    def with_done(self, numbered: StepTasks) -> StepTasks:
        """Return the step with the new indices of the remaining tasks."""
        new = dict(zip((t.index for t in self.tasks), numbered.tasks, strict=True))
        return replace(
            numbered,
            tasks=tuple(new.get(task.index, task) for task in self.step.tasks),
            allowed=(
                *renumber_contacts(self.step.allowed, self._own_indices),
                *numbered.allowed,
            ),
        )

    def numbered(self, first: int, fresh: StepTasks | None = None) -> StepTasks:
        """Return the remaining tasks with new indices, from the given one on.

        Args:
            first: that index.
            fresh: the step as it would be done now from its begin on: what is picked in it, and what
                touches, may have other names than when it was planned.
        """
        new = {task.index: first + k for k, task in enumerate(self.tasks)}
        known = {**self._own_indices, **new}
        tasks = tuple(replace(task, index=new[task.index]) for task in self.tasks)
        objects = self.step.objects
        waits = tuple(
            (known[a], new[b])
            for a, b in self.step.dependencies
            if a in known and b in new
        )
        allowed = renumber_contacts(self.step.allowed, known, new)
        if fresh is not None and _alike(fresh, self.step):
            pairs = zip(fresh.tasks, self.step.tasks, strict=True)
            now = {f.index: known[t.index] for f, t in pairs if t.index in known}
            allowed += tuple(
                replace(c, tasks=frozenset(now[t] for t in c.tasks if t in now))
                for c in fresh.allowed
            )
            named = {now[f.index]: f for f in fresh.tasks if f.index in now}
            tasks = tuple(_renamed(task, named[task.index]) for task in tasks)
            objects = fresh.objects
        return StepTasks(self.step.step, tasks, waits, allowed, objects)


def _renamed(task: Task, fresh: Task) -> Task:
    """Return a task with the objects of another one that does the same."""
    if task.object == fresh.object:
        return task
    moved = zip(task.handlings, fresh.handlings, strict=True)
    handlings = tuple(replace(h, object=own.object) for h, own in moved)
    return replace(task, object=fresh.object, label=fresh.label, handlings=handlings)


def _alike(fresh: StepTasks, step: StepTasks) -> bool:
    """Tell whether a step has the same tasks as another one."""
    return [(t.robot, t.kind) for t in fresh.tasks] == [
        (t.robot, t.kind) for t in step.tasks
    ]


def renumber_contacts(
    allowed: Sequence[AllowedContact],
    known: Mapping[int, int],
    among: Collection[int] | None = None,
) -> tuple[AllowedContact, ...]:
    """Return allowed contacts with renumbered tasks, without those of no remaining task.

    Args:
        allowed: the contacts.
        known: new index by old index.
        among: the contacts of these tasks only; None for all.
    """
    own = known.keys() if among is None else among
    return tuple(
        replace(
            contact, tasks=frozenset(known[t] for t in contact.tasks & known.keys())
        )
        for contact in allowed
        if not contact.tasks.isdisjoint(own)
    )


def unfinished_steps(
    world: World, reopened: Mapping[int, frozenset[str]]
) -> list[UnfinishedStep]:
    """Return the rest of the begun steps, straight exits first, then in their order.

    Args:
        world: what is complete.
        reopened: steps that are to be repeated, by number, with the robots that have nothing to bring
            to an end in them. Of the others only those continue that have done a skill in it, as far as
            their retreat: they stand where they are in the way. Whoever has something in the hand that
            goes nowhere any more does not go back as if it had been put down. Who is where a straight path
            leads out of, as of a rack of tools, goes that way.
    """
    found, holders = [], {at.holder for _, at in world.held()}
    for number, step in world.begun().items():
        left = [task for task in step.tasks if task.index not in world.complete]
        if number in reopened:
            done = {
                task.robot
                for task in step.tasks
                if task.kind not in (TaskKind.TRANSIT, *TaskKind.SUPPLY)
                and task.index in world.complete
            }
            brings = {task.robot for task in left if task.handlings}
            stays = done - reopened[number] - brings - holders
            others = dict.fromkeys(t.robot for t in step.tasks if t.robot not in stays)
            outs = [out for k in others for out in _retreat_path(step, k, world)]
            left = [*(task for task in left if task.robot in stays), *outs]
        left = [task for task in left if task.robot not in world.out]
        if left:
            own = frozenset(t.index for t in step.tasks if t.index in world.complete)
            kinds = (
                (TaskKind.TRANSIT, TaskKind.STRAIGHT)
                if number in reopened
                else (TaskKind.TRANSIT,)
            )
            ends = all(task.kind in kinds for task in left)
            found.append(UnfinishedStep(step, tuple(left), own, ends))
    return sorted(found, key=lambda item: (not item.ends, item.step.step))


def _retreat_path(step: StepTasks, robot: str, world: World) -> Iterator[Task]:
    """Yield the straight path of a robot out of the middle of a step, forwards or backwards."""
    own = [task for task in step.tasks if task.robot == robot]
    done = [task for task in own if task.index in world.complete]
    left = [task for task in own if task.index not in world.complete]
    if not done or not left or done[-1].index != world.beginning.last_task.get(robot):
        return
    *before, last = done
    if left[0].kind == TaskKind.STRAIGHT and last.kind != TaskKind.TRANSIT:
        yield left[0]
    elif left[0].kind != TaskKind.TRANSIT and last.kind == TaskKind.STRAIGHT and before:
        # It has its number: what touches on the way there touches on the retreat.
        back = np.concatenate([last.path[-2::-1], before[-1].path[-1:]])
        yield replace(last, label=f"back: {last.label}", path=read_only_copy(back))


def robots_with_unfinished_steps(
    left: Sequence[UnfinishedStep], but: int | None = None
) -> frozenset[str]:
    """Return the robots with unfinished work where they stand, except in one step.

    Not those that keep something in its place: it might fall.
    """
    others = [item for item in left if not item.ends and item.step.step != but]
    robots = {task.robot for item in others for task in item.tasks}
    return frozenset(robots - {k for item in left for k in robots if _keeps(item, k)})


def _keeps(left: UnfinishedStep, robot: str) -> bool:
    """Tell whether a robot holds something in its place, or must release something before it leaves."""
    own = [task for task in left.step.tasks if task.robot == robot]
    done = [task for task in own if task.index in left.complete]
    then = next((task for task in left.tasks if task.robot == robot), None)
    if then is None:
        return False
    lets_go = then.kind == TaskKind.STRAIGHT and then.object is not None
    return lets_go or (bool(done) and done[-1].kind == TaskKind.HOLD)


def as_start_of(cell: Workcell, world: World, busy: frozenset[str]) -> Workcell:
    """Return a cell whose initial state is a world.

    Args:
        cell: with all objects.
        world: the world; what is in a hand lies where that is.
        busy: robots that have something to do: all others stand where they are to the end.
    """
    robots = tuple(
        robot
        if robot.name in busy
        else replace(robot, home=read_only_copy(world.state.configurations[robot.name]))
        for robot in cell.robots
    )
    objects = []
    for item in cell.objects:
        if item.name in world.state.attachments:
            start = object_pose(cell, world.state, item.name)
            objects.append(replace(item, start=start, later=False))
        else:
            objects.append(replace(item, later=True))
    return replace(cell, robots=robots, objects=tuple(objects))


def rebase_first_tasks(tasks: Sequence[Task], world: World) -> tuple[Task, ...]:
    """Return tasks whose first ones pick up the loads of robots when a plan begins in a world."""
    held: dict[str, list[Handling]] = {}
    for name, at in world.held():
        held.setdefault(at.holder or "", []).append(
            Handling(name, 0, at.holder, at.pose)
        )
    found = []
    for task in tasks:
        more = tuple(held.pop(task.robot, ()))
        found.append(
            replace(task, handlings=(*more, *task.handlings)) if more else task
        )
    return tuple(found)
