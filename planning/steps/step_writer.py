"""Writes the tasks of one step one after another."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from planning.cell.workcell import CellObject, PlacedRobot, Workcell
from planning.steps.skill import Pairs, SkillPath, handled
from planning.tasks.task import (
    STILL,
    TRANSIT,
    AllowedContact,
    Handling,
    StepTasks,
    Task,
)
from planning.transforms import Array, Transform, readonly


@dataclass
class StepWriter:
    """Appends tasks and remembers what depends on what and what may touch what.

    Attributes:
        cell: robots with the tools on them that they have in the step.
        step: assembly step, counted from 1.
        first: index of the first task.
    """

    cell: Workcell
    step: int
    first: int
    _tasks: list[Task] = field(default_factory=list)
    _dependencies: list[tuple[int, int]] = field(default_factory=list)
    _allowed: dict[frozenset[str], set[int]] = field(default_factory=dict)
    _grazed: dict[frozenset[str], set[int]] = field(default_factory=dict)
    _objects: list[CellObject] = field(default_factory=list)

    def transit(
        self,
        robot: str,
        to: Array,
        label: str,
        carries: str | None,
        *,
        goal: bool = False,
    ) -> int:
        """Append a transit and return its index; with ``goal`` it may not be cut short."""
        path = readonly(np.atleast_2d(to))
        task = Task(
            *(self._next, robot, TRANSIT, self.step, label, path, (), carries), goal
        )
        return self._append(task)

    def home(self, robot: str, carries: str | None = None) -> int:
        """Append the transit of a robot to HOME, with what it carries."""
        label = f"HOME with {carries}" if carries else "HOME"
        return self.transit(robot, self.cell.robot(robot).home, label, carries)

    def stand(self, robot: PlacedRobot, label: str, handling: Handling) -> int:
        """Append a task in which something changes hands and the robot stays at HOME."""
        task = Task(
            *(self._next, robot.name, TRANSIT, self.step, label),
            readonly(robot.home[None]),
            (handling,),
        )
        return self._append(task)

    def skill(
        self,
        path: SkillPath,
        label: str,
        item: str | None,
        holder: str | None = None,
        pose: Transform | None = None,
        refill: CellObject | None = None,
    ) -> int:
        """Append a skill and return its index.

        Args:
            path: in joint space.
            label: for people.
            item: the object it is about.
            holder: who holds it once it has changed hands, None when it is put down.
            pose: of the object then; None for skills in which nothing changes hands.
            refill: object that comes up where it first is, at the end of the skill.
        """
        handlings: tuple[Handling, ...] = ()
        if pose is not None and item is not None and path.change_at is not None:
            change = Handling(item, path.change_at, holder, readonly(pose))
            handlings = (change,)
        if refill is not None:
            # The path counts from its start, which the task's own leaves out.
            coming = Handling(refill.name, len(path.path), None, refill.start)
            handlings = (*handlings, coming)
            self._objects.append(refill)
        task = Task(
            self._next,
            path.robot,
            path.skill,
            self.step,
            label,
            readonly(path.path),
            handlings,
            item,
        )
        return self._append(task)

    def unmoved(
        self,
        machine: str,
        kind: str,
        label: str,
        item: str,
        handlings: tuple[Handling, ...] = (),
    ) -> int:
        """Append a task of a machine at an object, and return its index."""
        task = Task(self._next, machine, kind, self.step, label, STILL, handlings, item)
        return self._append(task)

    def lead_in(self, path: SkillPath, label: str, carries: str | None) -> None:
        """Append the transits to where a skill starts."""
        for goal in path.lead:
            self.transit(path.robot, goal, label, carries)

    def depend(self, before: int, after: int) -> None:
        """Let one task wait for another."""
        self._dependencies.append((before, after))

    def allow(self, pairs: Pairs, *tasks: int) -> None:
        """Allow contacts during some tasks."""
        for entry in pairs:
            self._allowed.setdefault(entry, set()).update(tasks)

    def graze(self, pairs: Pairs, task: int) -> None:
        """Allow contacts no deeper than the contact tolerance during a task."""
        for entry in pairs:
            self._grazed.setdefault(entry, set()).add(task)

    @property
    def tasks(self) -> tuple[Task, ...]:
        """The tasks so far."""
        return tuple(self._tasks)

    def allow_carried(
        self, robot: str, item: str, first: int, last: int, *also: int
    ) -> None:
        """Let a robot's tool touch what it carries from one of its tasks to another.

        Args:
            robot: who carries it.
            item: the object.
            first, last: its first and last task with it.
            also: tasks of others in which they touch.
        """
        own = [
            task.index
            for task in self._tasks
            if task.robot == robot and first <= task.index <= last
        ]
        self.allow(handled(self.cell.robot(robot), item), *own, *also)

    def build(self) -> StepTasks:
        """Return the step."""
        allowed = []
        for pairs, grazing in ((self._allowed, False), (self._grazed, True)):
            for entry, tasks in sorted(pairs.items(), key=lambda e: sorted(e[0])):
                first, second = sorted(entry)
                contact = AllowedContact(first, second, frozenset(tasks), grazing)
                allowed.append(contact)
        return StepTasks(
            self.step,
            tuple(self._tasks),
            tuple(sorted(self._dependencies)),
            tuple(allowed),
            tuple(self._objects),
        )

    @property
    def _next(self) -> int:
        return self.first + len(self._tasks)

    def _append(self, task: Task) -> int:
        self._tasks.append(task)
        return task.index
