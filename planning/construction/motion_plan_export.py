"""Export of a space-time plan as the motion plan used by all later stages.

In a space-time plan, robots move simultaneously. Motions are divided into intervals of equal length (time cells), and
further where robots are close. Two pieces that overlap in time must keep the clearance at all points of both motions.
Then the temporal plan graph keeps the planned times, and its execution is free of collisions under any delay.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from planning.construction.checks.scene import HALVINGS
from planning.construction.piece_conflicts import conflicting_pieces
from planning.construction.problem.problem import ConstructionProblem
from planning.construction.world.fixed_world import (
    BuildState,
    FixedWorld,
    HeldPlacement,
    PlannedTask,
)
from planning.construction.world.timeline import (
    SAME,
    STEP,
    MotionPieces,
    RobotTimeline,
    cut_timeline,
    hand_changes,
)
from planning.construction.world.tracks import build_tracks, sweep_track
from planning.errors import PlanInvariantError
from planning.handling.skill_contacts import NOTHING, grip_contact
from planning.motion.motion_plan import MotionPlan, TaskMotion
from planning.tasks.task import AllowedContact, Task, TaskKind
from planning.transforms import Array, Indices

_FINER = 3
"""Further halvings of a time cell, beyond those of planning."""


def motion_plan(problem: ConstructionProblem, building: BuildState) -> MotionPlan:
    """Return a finished construction as tasks with timed paths.

    Between skills a robot has one transit; a retreat is a transit, too, as far as new work did not cut it short.

    Args:
        problem: the construction problem.
        building: everything planned.

    Raises:
        PlanInvariantError: two robots come too close at the same time, which is a fault of this
            program.
    """
    lines = (building.world.robots[robot.name] for robot in problem.cell.robots)
    return export_motion_plan(
        building.world,
        [task for line in lines for task in _tasks(building, line)],
        rests_on=placement_order(problem, building),
        covers=problem.graph.covers,
        kept=building.kept,
    )


def _tasks(building: BuildState, line: RobotTimeline) -> Iterator[PlannedTask]:
    """Yield the skills of a robot and the transits between them."""
    robot = line.robot
    own = sorted(
        (w for w in building.work if robot in (w.robot, w.holder)),
        key=lambda w: w.start,
    )
    at, carried = float(line.time[0]), _in_hand(building, robot)
    put = {work.object for work in own if work.kind == "place-down"}
    for part, own_part in building.kept.items():
        if own_part.robot == robot and part not in put:
            # It stands with it from the beginning on.
            at, carried = own_part.end, part
    for work in own:
        span = (at, work.start)
        yield from _transit(line, span, f"to {work.object}", work, carried)
        if work.robot == robot:
            yield _skill(line, work)
        at = work.end
        carried = work.object if work.holder == robot else None
        keeping = building.kept.get(str(work.object))
        if keeping is not None and (work.kind, work.robot) == ("place-down", robot):
            # It stands until then; on its retreat it leaves the part that it held.
            at, carried = keeping.end, work.object
    done = own[-1] if own else _nothing(building, robot)
    yield from _transit(line, (at, line.end), "HOME", done, carried)


def _in_hand(building: BuildState, robot: str) -> str | None:
    """Return the object that a robot holds when the plan begins."""
    begins = {
        k: own.changes[0] for k, own in building.world.objects.items() if own.changes
    }
    own = (k for k, c in begins.items() if np.isneginf(c.time) and c.holder == robot)
    return next(own, None)


def _nothing(building: BuildState, robot: str) -> PlannedTask:
    """Return the placeholder task of a robot that has only moved out of the others' way."""
    line = building.world.robots[robot]
    return PlannedTask(robot, TaskKind.TRANSIT, line.time[:1], line.path[:1], 1, "HOME")


def _transit(
    line: RobotTimeline,
    span: tuple[float, float],
    label: str,
    work: PlannedTask,
    carried: str | None,
) -> Iterator[PlannedTask]:
    """Yield the transit of a time span, none where the robot stands throughout."""
    start, end = span
    if end - start < SAME:
        return
    inside = (line.time > start + SAME) & (line.time < end - SAME)
    time = np.concatenate([[start], line.time[inside], [end]])
    path = np.vstack([_last_at(line, start), line.path[inside], line.at(end)])
    if not np.any(path[1:] != path[:-1]):
        return
    touching = NOTHING if carried is None else grip_contact(line.robot, carried)
    if line.robot != work.robot and work.holder == line.robot:
        # It stands with both pads at the part while that changes hands.
        part = str(work.object)
        touching |= grip_contact(line.robot, part) | grip_contact(work.robot, part)
    yield PlannedTask(
        line.robot,
        TaskKind.TRANSIT,
        time,
        path,
        work.step,
        label,
        carried,
        touching=touching,
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
    """Return the configuration of a robot after everything that happens at time ``t``."""
    k = int(np.searchsorted(line.time, t, side="right"))
    if k and line.time[k - 1] == t:
        return np.asarray(line.path[k - 1])
    return line.at(t)


def placement_order(
    problem: ConstructionProblem, building: BuildState
) -> dict[str, tuple[str, ...]]:
    """Return the precedence pairs of parts: which must be in place before which."""
    out: dict[str, tuple[str, ...]] = {}
    before: dict[str, float] = {}
    for name, end in building.placed.items():
        out[name] = tuple(sorted(problem.balance.ready(name, before)))
        before[name] = end
    return out


def export_motion_plan(
    world: FixedWorld,
    planned: Sequence[PlannedTask],
    *,
    rests_on: Mapping[str, Iterable[str]] | None = None,
    covers: Mapping[str, Iterable[str]] | None = None,
    kept: Mapping[str, HeldPlacement] | None = None,
) -> MotionPlan:
    """Return the motion plan of a space-time plan.

    Args:
        world: the cell, and the timelines of everything in it.
        planned: all tasks; those of one robot follow each other in time, from HOME on, and
            where there is none it stands.
        rests_on: for an object those that must be in place before it is put down.
        covers: for an object those that must be taken before it is.
        kept: objects that are held in their places, or were, with what must be in place before
            who does leaves.

    Raises:
        PlanInvariantError: two robots come too close at the same time; names both.
    """
    cell = world.cell
    robots = [robot.name for robot in cell.robots]
    tasks = sorted(planned, key=lambda t: (t.start, t.end, robots.index(t.robot)))
    motions = _motions(world, tasks, _cut(world, tasks))
    handled = [(h, k) for k, task in enumerate(tasks) for h in task.handlings]
    placed = {h.object: k for h, k in handled if h.holder is None}
    taken = {h.object: k for h, k in reversed(handled)}
    edges = _object_order(tasks) | _handling_order(placed, rests_on or {})
    edges |= _handling_order(taken, covers or {})
    for name, keeping in (kept or {}).items():
        since = tasks[placed[name]].end if name in placed else -np.inf
        moves = (
            k
            for k, task in enumerate(tasks)
            if task.kind == TaskKind.TRANSIT
            and (task.robot, task.object) == (keeping.robot, name)
            and task.start >= since - SAME
        )
        move = next(moves, None)
        if move is not None and keeping.last in placed:
            edges.add((placed[keeping.last], move))
    return MotionPlan(
        cell,
        tuple(
            Task(
                k,
                task.robot,
                task.kind,
                task.step,
                task.label,
                motions[k].path[-1:]
                if task.kind == TaskKind.TRANSIT
                else motions[k].path[1:],
                task.handlings,
                task.object,
            )
            for k, task in enumerate(tasks)
        ),
        tuple(motions),
        np.array(sorted(edges), dtype=np.int64).reshape(-1, 2),
        _allowed(tasks),
    )


class _Cut(NamedTuple):
    """The pieces of a robot, and for each the tasks it belongs to, shape (p, 2); see _tasks_of."""

    pieces: MotionPieces
    tasks: Indices


def _cut(world: FixedWorld, tasks: Sequence[PlannedTask]) -> dict[str, _Cut]:
    """Cut the motions of all robots until simultaneous pieces keep their clearances."""
    cell = world.cell
    cuts: dict[str, set[float]] = {robot.name: set() for robot in cell.robots}
    while True:
        cut: dict[str, _Cut] = {}
        swept = []
        for robot in cell.robots:
            own = [k for k, task in enumerate(tasks) if task.robot == robot.name]
            changes = hand_changes(world.objects, robot.name)
            bounds = [t for k in own for t in (tasks[k].start, tasks[k].end)]
            pieces = cut_timeline(
                world.robots[robot.name],
                0.0,
                np.inf,
                STEP,
                sorted({t for t, _ in changes[1:]} | set(bounds)),
                sorted(cuts[robot.name]),
            )
            swept.append(sweep_track(robot, pieces, changes, cell.object))
            cut[robot.name] = _Cut(pieces, _tasks_of(pieces, tasks, own))
        tracks = build_tracks(swept, 0)
        found = conflicting_pieces(
            cell,
            [carrier for track in swept for carrier in track.carriers],
            tracks,
            np.concatenate([one.tasks for one in cut.values()]),
            [task.touching for task in tasks],
        )
        if not found:
            return cut
        for i, j in found:
            _halve(cut, tracks.first, i, j, cuts, tasks)


def _halve(
    cut: Mapping[str, _Cut],
    first: Indices,
    i: int,
    j: int,
    cuts: dict[str, set[float]],
    tasks: Sequence[PlannedTask],
) -> None:
    """Halve two pieces that come too close; only the longer one where their durations differ."""
    names = list(cut)
    found: list[tuple[int, float, str]] = []
    words = []
    for piece in (i, j):
        r = int(np.searchsorted(first, piece, side="right")) - 1
        k = piece - int(first[r])
        pieces, owners = cut[names[r]]
        start, end = float(pieces.start[k]), float(pieces.end[k])
        label = tasks[int(owners[k, 0])].label if tasks else ""
        words.append(f"robot {names[r]!r} ({label}, from {start:.3f} s to {end:.3f} s)")
        if not _moves(pieces)[k] or pieces.whole[k]:
            continue
        for halvings in range(1, HALVINGS + _FINER + 1):
            size = STEP / (1 << halvings)
            middle = float(np.ceil(start / size + 1e-6) * size)
            if middle < end - SAME:
                found.append((halvings, middle, names[r]))
                break
    if not found:
        raise PlanInvariantError(
            f"{words[0]} and {words[1]} come too close to each other at the same time"
        )
    coarsest = min(f[0] for f in found)
    for halvings, middle, name in found:
        if halvings == coarsest:
            cuts[name].add(middle)


def _tasks_of(
    pieces: MotionPieces, tasks: Sequence[PlannedTask], own: Sequence[int]
) -> Indices:
    """Return the tasks that pieces belong to; for a hold, those before and after it."""
    if not own:
        return np.full((len(pieces.start), 2), -1, dtype=np.int64)
    ends = np.array([tasks[k].end for k in own])
    at = np.searchsorted(ends, pieces.moment + SAME, side="right")
    task = np.array(own)[np.minimum(at, len(own) - 1)]
    moves = _moves(pieces)
    places = np.arange(len(task))
    before = np.maximum.accumulate(np.where(moves, places, -1))
    after = np.minimum.accumulate(np.where(moves, places, len(task))[::-1])[::-1]
    some = np.flatnonzero(moves)
    if len(some) == 0:
        return np.stack([task, task], axis=1).astype(np.int64)
    before = np.where(before < 0, some[0], before)
    after = np.where(after >= len(task), some[-1], after)
    return np.stack([task[before], task[after]], axis=1).astype(np.int64)


def _moves(pieces: MotionPieces) -> npt.NDArray[np.bool_]:
    """Return which pieces are motions rather than holds, shape (p,).

    Time cells begin at multiples of their length, and a motion may end a rounding error after one. The ends of
    the hold after it then differ by as much; it is a hold nevertheless, and belongs to the tasks before and after it.
    """
    far = np.abs(pieces.q_a - pieces.q_b) > SAME
    return np.asarray(np.any(far, axis=1) | pieces.whole)


def _motions(
    world: FixedWorld, tasks: Sequence[PlannedTask], cut: Mapping[str, _Cut]
) -> list[TaskMotion]:
    """Return the path of every task, with a waypoint at the end of every piece."""
    out = []
    last = {name: line.path[0] for name, line in world.robots.items()}
    for task in tasks:
        if task.kind != TaskKind.TRANSIT:
            path, time = np.array(task.path), np.array(task.time)
            path[0] = last[task.robot]
        else:
            pieces = cut[task.robot].pieces
            inside = np.flatnonzero(
                (pieces.start >= task.start - SAME)
                & (pieces.end <= task.end + SAME)
                & ~pieces.whole
            )
            path = np.vstack([last[task.robot][None], pieces.q_b[inside]])
            time = np.concatenate([[task.start], pieces.end[inside]])
        out.append(TaskMotion(path, time))
        last[task.robot] = path[-1]
    return out


def _object_order(tasks: Sequence[PlannedTask]) -> set[tuple[int, int]]:
    """Return the dependencies between tasks of different robots that handle one object."""
    edges = set()
    last: dict[str, int] = {}
    events = [
        (float(task.time[h.waypoint]), k, h)
        for k, task in enumerate(tasks)
        for h in task.handlings
    ]
    for _, k, h in sorted(events, key=lambda e: (e[0], e[1])):
        if h.object in last and tasks[last[h.object]].robot != tasks[k].robot:
            edges.add((last[h.object], k))
        last[h.object] = k
        if h.holder is not None and h.holder != tasks[k].robot:
            # The receiver stands and waits; it continues when it has the object.
            partner = [n for n, t in enumerate(tasks) if t.robot == h.holder]
            before = [n for n in partner if tasks[n].end <= tasks[k].start + SAME]
            later = [n for n in partner if tasks[n].start >= tasks[k].end - SAME]
            edges |= {(n, k) for n in before[-1:]} | {(k, n) for n in later[:1]}
    return edges


def _handling_order(
    tasks: Mapping[str, int], waits_for: Mapping[str, Iterable[str]]
) -> set[tuple[int, int]]:
    """Return dependencies of the tasks of objects on those of the objects that they wait for."""
    return {
        (tasks[first], tasks[then])
        for then, before in waits_for.items()
        for first in before
        if then in tasks and first in tasks
    }


def _allowed(tasks: Sequence[PlannedTask]) -> tuple[AllowedContact, ...]:
    pairs: dict[tuple[str, str], set[int]] = {}
    for k, task in enumerate(tasks):
        for pair in task.touching:
            first, second = sorted(pair)
            pairs.setdefault((first, second), set()).add(k)
    return tuple(
        AllowedContact(a, b, frozenset(which))
        for (a, b), which in sorted(pairs.items())
    )
