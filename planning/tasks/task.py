"""Tasks and steps as data, with their handlings and allowed contacts (APEX-MR IV-A)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from planning.cell.workcell import CellObject, Workcell
from planning.transforms import Array, Transform, readonly

TRANSIT = "transit"
SKILLS = ("pick", "place-down", "place-up", "handover", "support-bottom", "support-top")
"""Skills with timings of their own in the package; further ones have any other name."""

STRAIGHT = "straight"
"""Kind of a motion on a given path that takes as long as the robot's speed lets it, such as the
way to where a process begins."""

HOLD = "hold"
"""Skill of gripping a part where it lies while another robot works at it."""

LEAVE_TOOL, TAKE_TOOL = "leave-tool", "take-tool"
"""Skills of letting go of a tool in its rack, and of locking one on the flange."""


@dataclass(frozen=True)
class Handling:
    """A change of hands within a task: an object is picked up, put down or handed over.

    Attributes:
        object: its name.
        waypoint: index into the task's path (0 = the configuration the task starts from) at
            which it happens.
        holder: robot that holds it from then on, None when it is put down, or comes up: the
            next brick of a feeding station is there once the one before it has been picked.
        pose: of the object's centre in the holder's flange frame, or in the world.
    """

    object: str
    waypoint: int
    holder: str | None
    pose: Transform


@dataclass(frozen=True)
class Task:
    """A piece of work of one robot: a transit to a goal, or a skill.

    Attributes:
        index: position in the sequential plan; the task's identity everywhere.
        robot: who does it.
        kind: ``"transit"``, ``"straight"``, or the name of a skill: one of SKILLS, ``"hold"``,
            ``"leave-tool"``, ``"take-tool"``, or a process that the scenario names.
        step: assembly step it serves, counted from 1.
        label: short text for people, such as ``"pick b2_4"``.
        path: joint waypoints after the start, shape (w, n): the goal alone for a transit, the
            subgoals of the reference path for a skill.
        handlings: what changes hands in it, in order; ``waypoint`` counts within [start, *path].
        object: object it is about, None for a plain move.
        goal: whether its end is what the robot is to reach, so that no shortcut may pass by it.
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


@dataclass(frozen=True)
class AllowedContact:
    """A pair of things that may touch while certain tasks are under way.

    Attributes:
        first, second: ``"<robot>/tool"``, an object's name or a fixture's name, unordered.
        tasks: indices of the tasks. A contact of a node of task m with something that is not a
            robot's node needs m in ``tasks``; a contact between nodes of tasks m and m' of two
            robots needs both.
        grazing: whether it was measured to be no deeper than the cell's contact tolerance.
    """

    first: str
    second: str
    tasks: frozenset[int]
    grazing: bool = False


@dataclass(frozen=True)
class StepTasks:
    """One assembly step, expanded.

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
    """Return the cell with the objects that come up in some steps."""
    coming = tuple(item for step in steps for item in step.objects)
    return replace(cell, objects=(*cell.objects, *coming)) if coming else cell


STILL = readonly(np.zeros((1, 1)))
"""Path of a machine, which does not move."""

ARRIVE = "arrive"
"""Kind of the task that waits until the next part has come along a conveyor."""

PRESENT = "present"
"""Kind of the task after which the next part, or a full tray, is where it is picked."""

LEAVE = "leave"
"""Kind of the task after which a finished product is gone."""

SUPPLY_KINDS = (ARRIVE, PRESENT, LEAVE)

DOOR = "door"
"""Kind of the object that is the door of a machine while that works."""

GONE = "(gone)"
"""Stands for the holder of an object that has left the cell; no robot can have this name."""


def door_shut(door: str, pose: Transform) -> tuple[Handling, Handling]:
    """Return how a door comes up when a task begins, and is gone when it is over.

    So nobody may be where it is for as long as the task may last, and it rests nowhere in between.
    """
    return Handling(door, 0, None, pose), Handling(door, 1, GONE, pose)


T = TypeVar("T")

ExceptionKey = tuple[str, str | None, str | None]
"""Skill, robot and type of object of an exception; None stands for any."""


def strongest_exception(
    exceptions: Mapping[ExceptionKey, T], skill: str, robot: str, kind: str | None
) -> T | None:
    """Return what holds for a skill done by a robot to an object of a kind, None if nothing does.

    Robot and object beat the robot alone, which beats the object alone.
    """
    for key in ((skill, robot, kind), (skill, robot, None), (skill, None, kind)):
        found = exceptions.get(key)
        if found is not None:
            return found
    return None
