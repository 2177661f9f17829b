"""Deliveries and removals of parts by machines when the rest of an assembly is replanned.

Each source is refilled once and each tray is exchanged once: deliveries are not repeated when a step restarts, and
deliveries after a step also take place if the step is abandoned. A person removes objects that are no longer
needed if they block others or are in the hand of a robot.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from planning.cell.workcell import Workcell
from planning.kinematics.kinematics import frame_pose
from planning.tasks.assembly import Assembly, Disposal
from planning.tasks.assignment import TaskPlan
from planning.tasks.task import (
    STILL,
    AllowedContact,
    Handling,
    StepTasks,
    Task,
    TaskKind,
)
from planning.transforms import Transform, read_only_copy
from planning.worlds.world import World, renumber_contacts

REMOVAL = "removal"
"""Name of the pseudo-machine by which a person removes obstacles."""


def brings_parts(task: Task) -> bool:
    """Tell whether a machine delivers or removes parts in a task."""
    return task.kind in TaskKind.SUPPLY and task.kind != TaskKind.LAG


def supplied_tasks_by_step(world: World) -> dict[int, tuple[Task, ...]]:
    """Return the completed deliveries and removals of each step, by its number, in order."""
    found: dict[int, dict[int, Task]] = {}
    for step in (*world.past, *world.steps):
        own = {
            t.index: t
            for t in step.tasks
            if brings_parts(t) and t.index in world.complete
        }
        if own:
            found.setdefault(step.step, {}).update(own)
    return {number: tuple(own[k] for k in sorted(own)) for number, own in found.items()}


def without_supplied_tasks(step: StepTasks, delivered: Sequence[Task]) -> StepTasks:
    """Return a step without its completed deliveries and removals."""
    if not delivered:
        return step
    old = {(t.kind, t.robot, t.object): t.index for t in delivered}
    keys = {t.index: (t.kind, t.robot, t.object) for t in step.tasks if brings_parts(t)}
    done = {index: old[key] for index, key in keys.items() if key in old}
    return _some_of(step, [t for t in step.tasks if t.index not in done], done)


def _some_of(
    step: StepTasks, tasks: Sequence[Task], done: Mapping[int, int]
) -> StepTasks:
    """Return a step of some of its tasks, which wait for the completed ones by their old indices."""
    first = min((task.index for task in step.tasks), default=0)
    new = {task.index: first + k for k, task in enumerate(tasks)}
    known = {**done, **new}
    return replace(
        step,
        tasks=tuple(replace(task, index=new[task.index]) for task in tasks),
        dependencies=tuple(
            (known[a], new[b]) for a, b in step.dependencies if a in known and b in new
        ),
        allowed=renumber_contacts(step.allowed, new),
    )


@dataclass
class RemovalPlan:
    """Removal of rejected parts, and of the objects of given-up steps, so that later steps become possible.

    Attributes:
        world: where the plan begins.
        passing: objects that lie where others come after them.
        given_up: objects of the steps that are not done.
        rejected: rejected parts, by the number of the given-up step.
        removed: those that are removed in the plan, with the task that takes them.
        lies: current poses of objects that the plan has moved; None for those in a hand or gone.
        leaves: absent objects, with the tasks in which their products leave without them, and their places there.
    """

    world: World
    passing: Collection[str]
    given_up: frozenset[str]
    rejected: Mapping[int, Disposal] = field(default_factory=dict)
    removed: dict[str, int] = field(default_factory=dict)
    lies: dict[str, Transform | None] = field(default_factory=dict)
    leaves: dict[str, tuple[int, Transform]] = field(default_factory=dict)

    def of_step(
        self,
        assembly: Assembly,
        step: int,
        delivered: Sequence[Task],
        plan: TaskPlan,
        first: int,
    ) -> Iterator[tuple[TaskPlan, StepTasks]]:
        """Yield the substitutes of a given-up step: its part is removed, and machines continue.

        Args:
            assembly: expands it.
            step: its number.
            delivered: what was brought in it before.
            plan: the choices, which it leaves as they are.
            first: index of its first task.
        """
        fresh = assembly.expand(plan, step, first)
        left = without_supplied_tasks(fresh, delivered)
        own = _some_of(left, [t for t in left.tasks if brings_parts(t)], {})
        order = self.rejected.get(step)
        name = plan[step].object if order is None else order.part
        for removal in self._removals(assembly, plan, step, name, first):
            count = len(removal.tasks)
            later = [replace(t, index=t.index + count) for t in own.tasks]
            waits = [(a + count, b + count) for a, b in own.dependencies]
            tasks = (*removal.tasks, *later)
            waits = [*removal.dependencies, *waits]
            yield plan, replace(removal, tasks=tasks, dependencies=tuple(waits))

    def _removals(
        self, assembly: Assembly, plan: TaskPlan, step: int, name: str, first: int
    ) -> Iterator[StepTasks]:
        """Yield the removals of an object: of a rejected part by robots, and last by a person."""
        pose = self._lies(name)
        if pose is None:
            yield StepTasks(step, (), (), ())
            return
        if step in self.rejected:
            state = self.world.state.attachments
            now = {k: None if at.holder else at.pose for k, at in state.items()}
            lying = {k: at for k, at in {**now, **self.lies}.items() if at is not None}
            for tasks in assembly.disposals(self.rejected[step], lying, plan, first):
                picks = (t.index for t in tasks.tasks if t.kind == "pick")
                self.removed[name] = next(picks)
                yield tasks
        words = f"{name} is taken away"
        gone = (Handling(name, 1, Handling.GONE, pose),)
        about = first, REMOVAL, TaskKind.TAKEN_OUT, step, words, STILL, gone, name
        self.removed[name] = first
        yield StepTasks(step, (Task(*about),), (), ())

    def _lies(self, name: str) -> Transform | None:
        """Return the pose of an object that must be removed, None where it stays or is nowhere."""
        if name not in self._rejected_parts.union(self.passing) or name in self.removed:
            return None
        if name in self.lies:
            return self.lies[name]
        at = self.world.state.attachments.get(name)
        return None if at is None or at.holder is not None else at.pose

    @property
    def _rejected_parts(self) -> set[str]:
        return {order.part for order in self.rejected.values()}

    def without_absent_objects(self, step: StepTasks) -> StepTasks:
        """Return a step in which only present objects leave the cell, and record their final poses."""
        away = self.given_up | self.removed.keys() | self._rejected_parts

        def stays(h: Handling) -> bool:
            return h.holder == Handling.GONE and h.object in away

        for t in filter(brings_parts, step.tasks):
            absent = filter(stays, t.handlings)
            self.leaves |= {h.object: (t.index, h.pose) for h in absent}
        tasks = tuple(
            replace(t, handlings=tuple(h for h in t.handlings if not stays(h)))
            if brings_parts(t)
            else t
            for t in step.tasks
        )
        for h in (h for t in tasks for h in t.handlings):
            self.lies[h.object] = h.pose if h.holder is None else None
        return replace(step, tasks=tasks)

    def waits(self, tasks: Iterable[Task]) -> Iterator[tuple[int, int]]:
        """Yield the dependencies of removals: what precedes them, deliveries to the freed places, and departures."""
        tasks = tuple(tasks)
        # What is on a product is taken off, by whichever plan, before that leaves.
        lies: dict[str, Transform] = {}
        for task in sorted(tasks, key=lambda task: task.index):
            for h in (h for h in task.handlings if h.object in self.leaves):
                index, place = self.leaves[h.object]
                if h.holder is None:
                    lies[h.object] = h.pose
                elif task.index < index and np.allclose(lies.get(h.object, 0), place):
                    yield task.index, index
        for task in tasks:
            for name, index in self.removed.items():
                about = task.object == name or any(
                    h.object == name for h in task.handlings
                )
                if about and task.index < index:
                    yield task.index, index
        # Also what comes up again waits for what an earlier plan had taken from there.
        removed = {t.index: t for t in tasks if t.robot == REMOVAL}
        for index, own in removed.items():
            pose = own.handlings[0].pose
            for task in tasks:
                comes = any(np.allclose(h.pose, pose) for h in task.handlings)
                if brings_parts(task) and task.index > index and comes:
                    yield index, task.index


def find_removal(
    cell: Workcell, world: World, robot: str, name: str, step: int, first: int
) -> StepTasks:
    """Return the step of a robot that waits at HOME until its load has been removed.

    Args:
        cell: with the robot.
        world: in which it holds that.
        robot: the robot.
        name: the held object.
        step: for which it was picked.
        first: index of the task.
    """
    placed = cell.robot(robot)
    pose = frame_pose(placed, placed.home) @ world.state.attachments[name].pose
    gone = (
        Handling(name, 1, None, read_only_copy(pose)),
        Handling(name, 1, Handling.GONE, read_only_copy(pose)),
    )
    path, label = read_only_copy(placed.home[None]), f"{name} is taken out"
    task = Task(first, robot, TaskKind.TAKEN_OUT, step, label, path, gone, name)
    # As it is let go of, it is still where the tool touches it.
    touches = AllowedContact(f"{robot}/tool", name, frozenset({first}))
    return StepTasks(step, (task,), (), (touches,))
