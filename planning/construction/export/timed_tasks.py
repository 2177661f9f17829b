"""Conversion of a planned construction to tasks with timed paths."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from planning.construction.export.motion_plan_export import export_motion_plan
from planning.construction.problem.problem import ConstructionProblem
from planning.construction.world.building import Building, PlannedTask
from planning.construction.world.timeline import SAME, RobotTimeline
from planning.motion.motion_plan import MotionPlan
from planning.skills.contacts import NOTHING, gripped
from planning.tasks.task import TRANSIT
from planning.transforms import Array


def motion_plan(problem: ConstructionProblem, building: Building) -> MotionPlan:
    """Return a finished construction as tasks with timed paths.

    Between skills a robot has one transit; its way out of the others' way is a transit, too, as
    far as new work did not cut it short.

    Args:
        problem: what was built by whom.
        building: everything planned.

    Raises:
        PlanInvariantError: two robots come too close at the same time, which is a fault of this
            program.
    """
    lines = (building.world.robots[robot.name] for robot in problem.cell.robots)
    return export_motion_plan(
        building.world,
        [task for line in lines for task in _tasks(building, line)],
        rests_on=_rests_on(problem, building),
        covers=problem.graph.covers,
    )


def _tasks(building: Building, line: RobotTimeline) -> Iterator[PlannedTask]:
    """Yield the skills of a robot and the transits between them."""
    robot = line.robot
    own = sorted(
        (w for w in building.work if robot in (w.robot, w.holder)),
        key=lambda w: w.start,
    )
    at, carried = float(line.time[0]), None
    for work in own:
        span = (at, work.start)
        yield from _transit(line, span, f"to {work.object}", work, carried)
        if work.robot == robot:
            yield _skill(line, work)
        at = work.end
        carried = work.object if work.holder == robot else None
    if own:
        yield from _transit(line, (at, line.end), "HOME", own[-1], carried)


def _transit(
    line: RobotTimeline,
    span: tuple[float, float],
    label: str,
    work: PlannedTask,
    carried: str | None,
) -> Iterator[PlannedTask]:
    """Yield the transit of a span of time, none where the robot stands all the time."""
    start, end = span
    if end - start < SAME:
        return
    inside = (line.time > start + SAME) & (line.time < end - SAME)
    time = np.concatenate([[start], line.time[inside], [end]])
    path = np.vstack([_last_at(line, start), line.path[inside], line.at(end)])
    if not np.any(path[1:] != path[:-1]):
        return
    touching = NOTHING if carried is None else gripped(line.robot, carried)
    if work.holder == line.robot != work.robot:
        # It stands with both pads at the part while that changes hands.
        part = str(work.object)
        touching |= gripped(line.robot, part) | gripped(work.robot, part)
    yield PlannedTask(
        line.robot, TRANSIT, time, path, work.step, label, carried, touching=touching
    )


def _skill(line: RobotTimeline, work: PlannedTask) -> PlannedTask:
    """Return a skill as it is on the timeline: rounding may add waypoints at its ends."""
    lo = int(np.searchsorted(line.time, work.start))
    hi = int(np.searchsorted(line.time, work.end, side="right"))
    time, path = line.time[lo:hi], line.path[lo:hi]
    # The waypoints with which the motions before and after it end and begin are left out.
    first = int(np.flatnonzero(np.all(path == path[0], axis=1) & (time == time[0]))[-1])
    last = int(np.flatnonzero(np.all(path == path[-1], axis=1) & (time == time[-1]))[0])
    time, path = time[first : last + 1], path[first : last + 1]
    touch = int(np.searchsorted(time, work.touch, side="right")) - 1
    handling = replace(work.handlings[0], waypoint=touch)
    return replace(work, time=time, path=path, handlings=(handling,))


def _last_at(line: RobotTimeline, t: float) -> Array:
    """Return where a robot is at the end of what happens at time ``t``."""
    k = int(np.searchsorted(line.time, t, side="right"))
    if k and line.time[k - 1] == t:
        return np.asarray(line.path[k - 1])
    return line.at(t)


def _rests_on(
    problem: ConstructionProblem, building: Building
) -> dict[str, tuple[str, ...]]:
    """Return which parts must be in place before which."""
    graph, placed = problem.graph, building.placed
    out = {}
    for name in placed:
        below = tuple(sorted(graph.carriers[name])) if problem.carried else ()
        if not below and name not in graph.ground:
            near = [n for n in graph.neighbours[name] if n in placed]
            below = (min(near, key=lambda n: placed[n]),)
        out[name] = below
    return out
