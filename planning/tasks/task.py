"""Tasks, steps and time windows as data, with transfers of objects and allowed contacts (APEX-MR IV-A)."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from planning.cell.workcell import Attachment, CellObject, Workcell, WorldState
from planning.transforms import Array, Transform, read_only_copy

ActuationKey = tuple[str, str, str | None]
"""Kind of actuation, robot, and name of its tool."""

STILL = read_only_copy(np.zeros((1, 1)))
"""Path of a machine, which does not move."""

DOOR = "door"
"""Kind of the object that is the door of a machine while that works."""

T = TypeVar("T")

ExceptionKey = tuple[str, str | None, str | None]
"""Skill, robot and type of object of an exception; None means any."""


class TaskKind:
    """Kinds of tasks that the planner knows; the name of a process of a scenario is a kind, too.

    Attributes:
        TRANSIT: a motion to a goal, on a path that the planner finds.
        SKILLS: skills with timings of their own in the package; further ones have any other name.
        HANDLING: skills in which an object changes hands, so that it can be lost.
        STRAIGHT: a motion on a given path that takes as long as the robot's speed lets it, such as
            the approach to a process.
        HOLD: the skill of gripping a part where it lies while another robot works at it.
        LEAVE_TOOL, TAKE_TOOL: letting go of a tool in its rack, and locking one on the flange.
        FAILED: a skill of which all attempts have failed: its robot stands where it began.
        TAKEN_OUT: a robot waits at HOME until a person has removed its load.
        LEFT_OUT: a planned task that is omitted because its purpose is achieved by other tasks.
        ARRIVE: until the next part has come along a conveyor.
        PRESENT: after it the next part, or a full tray, is where it is picked.
        LEAVE: after it a finished product is gone.
        LAG: the least time between two steps passes, see ``TimeWindow``.
        CHANGEOVER: a machine or a place is made ready for products of another variant.
        BROUGHT: after it something is there that was late, or that a person brings or sees to.
        GOES_ON: the remaining work of a machine that was at work when a plan began in the middle.
        SUPPLY: tasks of machines that work at no part.
    """

    TRANSIT = "transit"
    SKILLS = (
        "pick",
        "place-down",
        "place-up",
        "handover",
        "support-bottom",
        "support-top",
    )
    HANDLING = ("pick", "place-down", "place-up", "handover")
    STRAIGHT = "straight"
    HOLD = "hold"
    LEAVE_TOOL = "leave-tool"
    TAKE_TOOL = "take-tool"
    FAILED = "failed-attempt"
    TAKEN_OUT = "taken-out"
    LEFT_OUT = "left-out"
    ARRIVE = "arrive"
    PRESENT = "present"
    LEAVE = "leave"
    LAG = "lag"
    CHANGEOVER = "change-over"
    BROUGHT = "brought"
    GOES_ON = "goes-on"
    SUPPLY = (ARRIVE, PRESENT, LEAVE, LAG, CHANGEOVER, BROUGHT, GOES_ON)


@dataclass(frozen=True)
class Actuation:
    """An interval of a skill in which its robot stands while a tool closes or opens.

    Attributes:
        CLOSE, OPEN: acts that grip and release: fingers close and open, suction goes on and off.
        waypoint: index into the task's path (0 = the configuration the task starts from) at which it
            is over; the waypoint before it is the same configuration.
        act: CLOSE or OPEN.
        robot: whose tool it is; the receiver's, where that takes what the robot of the task gives it.
        tool: its name in the cell, None where it has none.
    """

    CLOSE = "close"
    OPEN = "open"

    waypoint: int
    act: str
    robot: str
    tool: str | None = None

    @property
    def key(self) -> ActuationKey:
        """Key of its duration."""
        return self.act, self.robot, self.tool


@dataclass(frozen=True)
class Handling:
    """A change of hands within a task: an object is picked up, put down or handed over.

    Attributes:
        GONE: in place of the holder of an object that has left the cell; no robot can have this name.
        object: its name.
        waypoint: index into the task's path (0 = the configuration the task starts from) at
            which it happens.
        holder: robot that holds it from then on, None when it is put down, or comes up: the
            next brick of a feeding station is there once the one before it has been picked.
        pose: of the object's centre in the holder's flange frame, or in the world.
    """

    GONE = "(gone)"

    object: str
    waypoint: int
    holder: str | None
    pose: Transform


@dataclass(frozen=True)
class Task:
    """A unit of work of one robot: a transit to a goal, or a skill.

    Attributes:
        index: position in the sequential plan; the task's identity everywhere.
        robot: the robot.
        kind: one of ``TaskKind``, or a process that the scenario names.
        step: assembly step it serves, counted from 1.
        label: short text for people, such as ``"pick b2_4"``.
        path: joint waypoints after the start, shape (w, n): the goal alone for a transit, the
            subgoals of the reference path for a skill.
        handlings: what changes hands in it, in order; ``waypoint`` counts within [start, *path].
        object: object it is about, None for a plain move.
        goal: whether its end is what the robot is to reach, so that no shortcut may pass by it.
        actuations: when tools close and open in it, in order.
    """

    index: int
    robot: str
    kind: str
    step: int
    label: str
    path: Array
    handlings: tuple[Handling, ...] = ()
    object: str | None = None
    goal: bool = False
    actuations: tuple[Actuation, ...] = ()


def still_borders(task: Task, last: int) -> list[int]:
    """Return the waypoints of a skill at which the robot is at rest, first and last included.

    Between two of them the robot moves, or it stands and a tool closes or opens.

    Args:
        task: the skill.
        last: waypoint at which it ends, counted from its start.
    """
    borders = {0, last}
    borders.update(*((a.waypoint - 1, a.waypoint) for a in task.actuations))
    return sorted(borders)


@dataclass(frozen=True)
class AllowedContact:
    """A pair of things that may touch during certain tasks.

    Attributes:
        first, second: ``"<robot>/tool"``, an object's name or a fixture's name, unordered.
        tasks: indices of the tasks. A contact of a node of task m with something that is not a
            robot's node needs m in ``tasks``; a contact between nodes of tasks m and m' of two
            robots needs both.
        grazing: whether it was measured to be no deeper than the cell's contact tolerance.
        depth: how deep the convex pieces of the two may be in each other; None for as deep as the cell
            says [m].
    """

    first: str
    second: str
    tasks: frozenset[int]
    grazing: bool = False
    depth: float | None = None


@dataclass(frozen=True)
class StepTasks:
    """The tasks of one assembly step.

    Attributes:
        step: assembly step, from 1.
        tasks: in sequential order; indices are consecutive.
        dependencies: pairs (a, b) of task indices within the step: a before b.
        allowed: contacts allowed during these tasks.
        objects: what comes up in these tasks, such as the next brick of a feeding station.
    """

    step: int
    tasks: tuple[Task, ...]
    dependencies: tuple[tuple[int, int], ...]
    allowed: tuple[AllowedContact, ...]
    objects: tuple[CellObject, ...] = ()


def cell_with_steps(cell: Workcell, steps: Iterable[StepTasks]) -> Workcell:
    """Return the cell with the objects that arrive in some steps added."""
    coming = {item.name: item for step in steps for item in step.objects}
    known = {item.name for item in cell.objects} if coming else set()
    new = [item for name, item in coming.items() if name not in known]
    return replace(cell, objects=(*cell.objects, *new)) if new else cell


def changed_tools(tasks: Iterable[Task]) -> frozenset[str]:
    """Return the names of the tools that robots leave in racks or take from there in some tasks."""
    changes = TaskKind.LEAVE_TOOL, TaskKind.TAKE_TOOL
    return frozenset(str(task.object) for task in tasks if task.kind in changes)


def is_work(task: Task, tools: Collection[str] = ()) -> bool:
    """Tell whether a robot or a machine works for a product, and not with one of the tools at its rack."""
    other = task.kind == TaskKind.TRANSIT or task.kind in TaskKind.SUPPLY
    return not other and task.object not in tools


def is_product_task(task: Task, tools: Collection[str] = ()) -> bool:
    """Tell whether a robot or a machine does a task on a product, beyond taking a part for it."""
    return task.kind != "pick" and is_work(task, tools)


def strongest_exception(
    exceptions: Mapping[ExceptionKey, T], skill: str, robot: str, kind: str | None
) -> T | None:
    """Return the most specific exception for a robot's skill on an object type, None for none.

    Robot and object beat the robot alone, which beats the object alone.
    """
    for key in ((skill, robot, kind), (skill, robot, None), (skill, None, kind)):
        found = exceptions.get(key)
        if found is not None:
            return found
    return None


def apply_handlings(state: WorldState, handlings: Iterable[Handling]) -> WorldState:
    """Return the state after changes of hands, the same object if there are none."""
    handlings = list(handlings)
    if not handlings:
        return state
    attachments = dict(state.attachments)
    for handling in handlings:
        if handling.holder == Handling.GONE:
            attachments.pop(handling.object, None)
            continue
        attachments[handling.object] = Attachment(handling.holder, handling.pose)
    return WorldState(state.configurations, attachments)


def allowed_pairs(
    cell: Workcell,
    state: WorldState,
    robot: str,
    task: int,
    last_task: Mapping[str, int],
    allowed: Iterable[AllowedContact],
) -> frozenset[frozenset[str]]:
    """Return the allowed contacts while one robot does a task and the others stand.

    Args:
        cell: the cell.
        state: where everything is; an object held by another robot counts as that robot.
        robot: the moving robot.
        task: index of its task.
        last_task: task that each other robot did last; absent for one that did none yet.
        allowed: the table of allowed contacts.
    """
    tools = {f"{placed.name}/tool": placed.name for placed in cell.robots}

    def owner(name: str) -> str | None:
        """Return the robot that a thing moves with, None for a thing at rest."""
        at = state.attachments.get(name)
        return tools.get(name, None if at is None else at.holder)

    pairs = set()
    for contact in allowed:
        if task not in contact.tasks:
            continue
        others = {owner(contact.first), owner(contact.second)} - {None, robot}
        if all(last_task.get(other or "", -1) in contact.tasks for other in others):
            pairs.add(frozenset((contact.first, contact.second)))
    return frozenset(pairs)


@dataclass(frozen=True)
class TimeWindow:
    """Bounds on the time from the end of a task to the start of another.

    As for glue that must be pressed while it is wet, or a part that must cool. The least time is kept by a task
    that lasts as long, so by the graph. The greatest one is not: it is planned for, held back for, and reported.

    Attributes:
        EARLIER: in place of the index of a task that was done before the plan begins.
        begun: index of the task with which the work of the earlier step begins; EARLIER where that was before
            the plan.
        done: index of the task with which that step is complete: its end opens the window; EARLIER likewise.
        due: index of the task whose start must lie in the window.
        least: [s].
        most: None for any [s].
        words: the two steps, for people.
        ago: how long before the begin of the plan the window was opened, where that is so [s].
    """

    EARLIER = -1

    begun: int
    done: int
    due: int
    least: float
    most: float | None
    words: str
    ago: float = 0.0

    @property
    def own(self) -> frozenset[int]:
        """The tasks of the plan that it refers to."""
        return frozenset({self.begun, self.done, self.due} - {self.EARLIER})

    def moved(self, new: Callable[[int], int]) -> TimeWindow:
        """Return the window with other task indices."""

        def index(task: int) -> int:
            return task if task == self.EARLIER else new(task)

        begun, done, due = map(index, (self.begun, self.done, self.due))
        return replace(self, begun=begun, done=done, due=due)
