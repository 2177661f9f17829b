"""Worlds made task by task, and paths that are asked for in few words, for tests."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planning.cell.workcell import Attachment, Workcell, WorldState
from planning.construction.checks.checker import SpaceTimeChecker
from planning.construction.checks.time_windows import arrival_windows
from planning.construction.paths.query import SpaceTimePath
from planning.construction.paths.rrt import space_time_rrt
from planning.construction.problem.settings import RrtSettings
from planning.construction.world.fixed_world import FixedWorld, PlannedTask
from planning.tasks.task import TaskKind
from planning.transforms import Array

PLAIN = RrtSettings(
    good_enough_s=0.2,
    acceptable_loss_s=0.0,
    patience=400,
    rounds=2,
    vertices=200,
    neighbours=8,
    checks=1000,
    most_loss_s=15.0,
)
"""The effort of a path that nothing is said about: more than that of the planner."""


def with_task(world: FixedWorld, task: PlannedTask, *, work: bool = True) -> FixedWorld:
    """The world after one more task; without ``work`` it is a way out of others' way."""
    line = world.robots[task.robot].then(
        task.time, task.path, skill=task.kind != TaskKind.TRANSIT, work=work
    )
    world = world.with_robot(line)
    for handling in task.handlings:
        at = float(task.time[handling.waypoint])
        item = world.objects[handling.object].then(at, handling.holder, handling.pose)
        world = world.with_object(item)
    return world


def world_of(cell: Workcell, tasks: Sequence[PlannedTask]) -> FixedWorld:
    """The world in which robots do tasks, given in order of time."""
    world = FixedWorld(cell)
    for task in tasks:
        world = with_task(world, task)
    return world


def state_at(world: FixedWorld, t: float) -> WorldState:
    """Where everything is at a time."""
    attachments: dict[str, Attachment] = {}
    for item in world.cell.objects:
        found = world.objects[item.name].at(t)
        if found is None and not item.later:
            found = Attachment(None, item.start)
        if found is not None:
            attachments[item.name] = found
    lines = world.robots.items()
    return WorldState({name: line.at(t) for name, line in lines}, attachments)


def find_path(
    checker: SpaceTimeChecker,
    goals: Array,
    settings: RrtSettings = PLAIN,
    *,
    windows: Sequence[Array] | None = None,
    stay: float = 0.0,
    not_before: float = 0.0,
    arrival: float | None = None,
    latest: float = np.inf,
    hints: Array | None = None,
    linger: bool = False,
    seed: int = 0,
) -> SpaceTimePath | None:
    """A path to goals at which the robot stays for a while, or at a given time of arrival."""
    goals = np.atleast_2d(np.asarray(goals, dtype=np.float64))
    latest = latest if arrival is None else min(latest, arrival)
    here = checker.start_configuration()
    if windows is None:
        travel = np.max(np.abs(goals - here) / checker.model.velocity, axis=1)
        soon = np.maximum(checker.start + travel, max(not_before, arrival or 0.0))
        windows = [
            arrival_windows([(checker, goal)], stay, float(earliest), latest)
            for goal, earliest in zip(goals, soon, strict=True)
        ]
    return space_time_rrt(
        checker,
        goals,
        windows,
        settings,
        latest=latest,
        hints=hints,
        linger=linger,
        seed=seed,
    )
