"""Conversion of a planned construction to tasks with timed paths."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from planning.construction.export.motion_plan_export import export_motion_plan
from planning.construction.export.planned_task import PlannedTask
from planning.construction.problem.contacts import Pairs, PartContacts, held_by
from planning.construction.problem.problem import ConstructionProblem
from planning.construction.world.building import Building, Work
from planning.construction.world.timeline import SAME, RobotTimeline
from planning.motion.motion_plan import MotionPlan
from planning.tasks.task import TRANSIT, Handling
from planning.transforms import Array, readonly

_WORDS = {"pick": "pick", "place-down": "place", "handover": "hand over"}


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
    contacts = PartContacts(problem)
    tasks = [
        task
        for robot in problem.cell.robots
        for task in _tasks(problem, contacts, building, robot.name)
    ]
    return export_motion_plan(
        problem.cell,
        tasks,
        rests_on=_rests_on(problem, building),
        covers=problem.graph.covers,
    )


def _tasks(
    problem: ConstructionProblem,
    contacts: PartContacts,
    building: Building,
    robot: str,
) -> Iterator[PlannedTask]:
    line = building.world.robots[robot]
    own = sorted(
        (w for w in building.work if robot in (w.robot, w.holder)),
        key=lambda w: w.start,
    )
    at, carried = float(line.time[0]), None
    for work in own:
        span = (at, work.start)
        yield from _transit(problem, line, span, f"to {work.part}", work, carried)
        if work.robot == robot:
            yield _skill(problem, contacts, line, work)
        at = work.end
        carried = work.part if work.holder == robot else None
    if own:
        span = (at, line.end)
        yield from _transit(problem, line, span, "HOME", own[-1], carried)


def _transit(
    problem: ConstructionProblem,
    line: RobotTimeline,
    span: tuple[float, float],
    label: str,
    work: Work,
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
    touching: Pairs = frozenset()
    if carried is not None:
        touching = held_by(line.robot, problem.part(carried))
    if work.holder == line.robot != work.robot:
        # It stands with both pads at the part while that changes hands.
        part = problem.part(work.part)
        touching |= held_by(line.robot, part) | held_by(work.robot, part)
    yield PlannedTask(
        line.robot,
        TRANSIT,
        time,
        path,
        work.step,
        label,
        carried,
        touching=touching,
    )


def _skill(
    problem: ConstructionProblem,
    contacts: PartContacts,
    line: RobotTimeline,
    work: Work,
) -> PlannedTask:
    k = line.skills.index(_span(line, work))
    lo, hi = np.searchsorted(line.time, line.skills[k]).tolist()
    hi = int(np.searchsorted(line.time, line.skills[k][1], side="right"))
    time, path = line.time[lo:hi], line.path[lo:hi]
    # The waypoints with which the motions before and after it end and begin are left out.
    first = int(np.flatnonzero(np.all(path == path[0], axis=1) & (time == time[0]))[-1])
    last = int(np.flatnonzero(np.all(path == path[-1], axis=1) & (time == time[-1]))[0])
    time, path = time[first : last + 1], path[first : last + 1]
    touch = int(np.searchsorted(time, work.touch, side="right")) - 1
    part = problem.part(work.part)
    touching = held_by(work.robot, part)
    if work.kind == "pick":
        touching |= contacts.at_start(part)
    elif work.kind == "handover":
        touching |= held_by(str(work.holder), part)
    elif work.kind == "place-down":
        touching |= contacts.at_goal(part)
    return PlannedTask(
        work.robot,
        work.kind,
        time,
        path,
        work.step,
        f"{_WORDS[work.kind]} {work.part}",
        work.part,
        (Handling(work.part, touch, work.holder, readonly(work.pose)),),
        touching,
    )


def _span(line: RobotTimeline, work: Work) -> tuple[float, float]:
    return min(line.skills, key=lambda s: abs(s[0] - work.start))


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
