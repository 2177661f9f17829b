"""Builder of the tasks of one step."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field

import numpy as np

from planning.cell.workcell import CellObject, PlacedRobot, Workcell
from planning.steps.skill import Pairs, SkillPath, handled_contact
from planning.tasks.refill import Refill
from planning.tasks.task import (
    STILL,
    Actuation,
    AllowedContact,
    Handling,
    StepTasks,
    Task,
    TaskKind,
)
from planning.transforms import Array, Transform, read_only_copy


@dataclass
class StepWriter:
    """Appends tasks and records dependencies and allowed contacts.

    Attributes:
        cell: robots with the tools on them that they have in the step.
        step: assembly step, counted from 1.
        first: index of the first task.
        actuated: whether it takes its time to close and to open a tool; else that is a part of skills.
    """

    cell: Workcell
    step: int
    first: int
    actuated: bool = False
    _tasks: list[Task] = field(default_factory=list)
    _dependencies: list[tuple[int, int]] = field(default_factory=list)
    _allowed: dict[tuple[bool, str, str], set[int]] = field(
        default_factory=lambda: defaultdict(set)
    )
    _objects: list[CellObject] = field(default_factory=list)

    def transit(
        self,
        robot: str,
        to: Array,
        label: str,
        carries: str | None = None,
        *,
        goal: bool = False,
    ) -> int:
        """Append a transit and return its index; with ``goal`` it may not be shortened."""
        path = np.atleast_2d(to)
        return self._append(
            robot, TaskKind.TRANSIT, label, path, (), carries, goal=goal
        )

    def home(self, robot: str, carries: str | None = None) -> int:
        """Append the transit of a robot to HOME, with its load."""
        label = f"HOME with {carries}" if carries else "HOME"
        return self.transit(robot, self.cell.robot(robot).home, label, carries)

    def stand(self, robot: PlacedRobot, label: str, handling: Handling) -> int:
        """Append a task in which something changes hands while the robot stays at HOME."""
        path = robot.home[None]
        return self._append(robot.name, TaskKind.TRANSIT, label, path, (handling,))

    def skill(
        self,
        path: SkillPath,
        label: str,
        item: str | None,
        holder: str | None = None,
        pose: Transform | None = None,
        refill: CellObject | None = None,
        *,
        lets_go: bool = False,
    ) -> int:
        """Append a skill and return its index.

        Where tools are actuated, the configuration in which one closes or opens comes once more for
        each time that it does, and what changes hands then does so when that is over.

        Args:
            path: in joint space.
            label: for people.
            item: the object it is about.
            holder: the holder after the change of hands, None when it is put down.
            pose: of the object then; None for skills in which nothing changes hands.
            refill: object that comes up where it first is, at the end of the skill.
            lets_go: whether its robot lets go of something before it moves.
        """
        at, acts = self._acts(path, holder, lets_go=lets_go)
        # The path counts from its start, which the task's own leaves out.
        still = np.repeat(path.waypoints[at : at + 1], len(acts), axis=0)
        waypoints = np.vstack([path.path[:at], still, path.path[at:]])
        change_at = None if path.change_at is None else path.change_at + len(acts)
        handlings: tuple[Handling, ...] = ()
        if pose is not None and item is not None and change_at is not None:
            change = Handling(item, change_at, holder, read_only_copy(pose))
            handlings = (change,)
        if refill is not None:
            coming = Handling(refill.name, len(waypoints), None, refill.start)
            handlings = (*handlings, coming)
            self._objects.append(refill)
        actuations = tuple(
            Actuation(at + k, act, robot, self.cell.robot(robot).tool)
            for k, (act, robot) in enumerate(acts, start=1)
        )
        robot, kind = path.robot, path.skill
        return self._append(
            robot, kind, label, waypoints, handlings, item, actuations=actuations
        )

    def _acts(
        self, path: SkillPath, holder: str | None, *, lets_go: bool
    ) -> tuple[int, tuple[tuple[str, str], ...]]:
        """Return the actuation waypoint of a skill, and the actions of the tools there in order."""
        own, last = path.robot, len(path.path)
        at = last if path.change_at is None else path.change_at
        if not self.actuated:
            return at, ()
        if lets_go:
            return 0, ((Actuation.OPEN, own),)
        if path.skill in ("pick", TaskKind.HOLD):
            return at, ((Actuation.CLOSE, own),)
        if path.skill == "handover":
            assert holder is not None
            return at, ((Actuation.CLOSE, holder), (Actuation.OPEN, own))
        # A robot that stays where it put something down keeps holding it.
        opens = path.skill == "place-down" and at < last
        return at, ((Actuation.OPEN, own),) if opens else ()

    def machine_task(
        self,
        machine: str,
        kind: str,
        label: str,
        item: str | None,
        handlings: tuple[Handling, ...] = (),
    ) -> int:
        """Append a task of a machine, possibly on an object, and return its index."""
        return self._append(machine, kind, label, STILL, handlings, item)

    def refill(self, refill: Refill, emptied: int) -> None:
        """Append the tasks of machines that refill a source after a task has emptied it."""
        name = refill.parts[0][0]
        if refill.arrivals is not None:
            come = self.machine_task(
                refill.arrivals, TaskKind.ARRIVE, f"{name} arrives", name
            )
            self.depend(come, come + 1)
        up = tuple(Handling(part, 1, None, pose) for part, pose in refill.parts)
        there = self.machine_task(
            refill.machine, TaskKind.PRESENT, f"{name} comes up", name, up
        )
        self.depend(emptied, there)

    def lead_in(self, path: SkillPath, label: str, carries: str | None = None) -> None:
        """Append the transits to the start of a skill."""
        for goal in path.lead:
            self.transit(path.robot, goal, label, carries)

    def depend(self, before: int, after: int) -> None:
        """Add a dependency between tasks."""
        self._dependencies.append((before, after))

    def allow(self, pairs: Pairs, *tasks: int, grazing: bool = False) -> None:
        """Allow contacts during some tasks; if grazing, no deeper than the contact tolerance."""
        for pair in pairs:
            first, second = sorted(pair)
            self._allowed[grazing, first, second].update(tasks)

    @property
    def tasks(self) -> tuple[Task, ...]:
        """The tasks so far."""
        return tuple(self._tasks)

    def allow_carried(
        self, robot: str, item: str, first: int, last: int, *also: int
    ) -> None:
        """Allow contact of a robot's tool with its load from one task to another.

        Args:
            robot: the robot that carries it.
            item: the object.
            first, last: its first and last task with it.
            also: tasks of others in which they touch.
        """
        own = [
            task.index
            for task in self._tasks
            if task.robot == robot and first <= task.index <= last
        ]
        self.allow(handled_contact(self.cell.robot(robot), item), *own, *also)

    def build(self) -> StepTasks:
        """Return the step."""
        allowed = (
            AllowedContact(first, second, frozenset(tasks), grazing)
            for (grazing, first, second), tasks in sorted(self._allowed.items())
        )
        return StepTasks(
            self.step,
            tuple(self._tasks),
            tuple(sorted(self._dependencies)),
            tuple(allowed),
            tuple(self._objects),
        )

    def _append(
        self,
        robot: str,
        kind: str,
        label: str,
        path: Array,
        handlings: tuple[Handling, ...] = (),
        item: str | None = None,
        *,
        goal: bool = False,
        actuations: tuple[Actuation, ...] = (),
    ) -> int:
        index, waypoints = self.first + len(self._tasks), read_only_copy(path)
        about = index, robot, kind, self.step, label, waypoints, handlings, item, goal
        self._tasks.append(Task(*about, actuations))
        return index
