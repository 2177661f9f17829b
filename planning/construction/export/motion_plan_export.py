"""Export of a space-time plan as the motion plan that everything after it takes.

Robots move at the same time in such a plan. Its motions are cut at the cells of time, and finer
where robots are close, until no two pieces that share time come too close, each anywhere on its
own: then the temporal plan graph keeps the planned times, and its guarantee under any delay.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from planning.cell.workcell import Workcell
from planning.construction.checks.scene import HALVINGS
from planning.construction.export.piece_conflicts import conflicting_pieces
from planning.construction.world.building import PlannedTask
from planning.construction.world.fixed_world import FixedWorld
from planning.construction.world.motion_pieces import STEP, Pieces, cut_timeline
from planning.construction.world.swept_track import sweep_track
from planning.construction.world.timeline import SAME, hand_changes
from planning.construction.world.tracks import build_tracks
from planning.errors import PlanInvariantError
from planning.motion.motion_plan import MotionPlan, TaskMotion
from planning.tasks.task import TRANSIT, AllowedContact, Task
from planning.transforms import Indices

_FINER = 3
"""Further halvings of a time cell, beyond those of planning."""


def export_motion_plan(
    world: FixedWorld,
    planned: Sequence[PlannedTask],
    *,
    rests_on: Mapping[str, Iterable[str]] | None = None,
    covers: Mapping[str, Iterable[str]] | None = None,
) -> MotionPlan:
    """Return the motion plan of a space-time plan.

    Args:
        world: the cell, and the timelines of everything in it.
        planned: all tasks; those of one robot follow each other in time, from HOME on, and
            where there is none it stands.
        rests_on: for an object those that must be in place before it is put down.
        covers: for an object those that must be taken before it is.

    Raises:
        PlanInvariantError: two robots come too close at the same time; names both.
    """
    cell = world.cell
    robots = [robot.name for robot in cell.robots]
    tasks = sorted(planned, key=lambda t: (t.start, t.end, robots.index(t.robot)))
    motions = _motions(cell, tasks, _cut(world, tasks))
    handled = [(h, k) for k, task in enumerate(tasks) for h in task.handlings]
    placed = {h.object: k for h, k in handled if h.holder is None}
    taken = {h.object: k for h, k in reversed(handled)}
    edges = _object_order(tasks) | _one_after_another(placed, rests_on or {})
    edges |= _one_after_another(taken, covers or {})
    return MotionPlan(
        cell,
        tuple(
            Task(
                k,
                task.robot,
                task.kind,
                task.step,
                task.label,
                motions[k].path[-1:] if task.kind == TRANSIT else motions[k].path[1:],
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

    pieces: Pieces
    tasks: Indices


def _cut(world: FixedWorld, tasks: Sequence[PlannedTask]) -> dict[str, _Cut]:
    """Cut the motions of all robots until those at the same time stay apart."""
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
    """Cut two pieces that come too close; the longer one where they differ."""
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
        if pieces.whole[k] or not np.any(pieces.q_a[k] != pieces.q_b[k]):
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
    pieces: Pieces, tasks: Sequence[PlannedTask], own: Sequence[int]
) -> Indices:
    """Return the tasks that pieces belong to, for a stand those before and after it."""
    if not own:
        return np.full((len(pieces.start), 2), -1, dtype=np.int64)
    ends = np.array([tasks[k].end for k in own])
    at = np.searchsorted(ends, pieces.moment + SAME, side="right")
    task = np.array(own)[np.minimum(at, len(own) - 1)]
    moves = np.any(pieces.q_a != pieces.q_b, axis=1) | pieces.whole
    places = np.arange(len(task))
    before = np.maximum.accumulate(np.where(moves, places, -1))
    after = np.minimum.accumulate(np.where(moves, places, len(task))[::-1])[::-1]
    some = np.flatnonzero(moves)
    if len(some) == 0:
        return np.stack([task, task], axis=1).astype(np.int64)
    before = np.where(before < 0, some[0], before)
    after = np.where(after >= len(task), some[-1], after)
    return np.stack([task[before], task[after]], axis=1).astype(np.int64)


def _motions(
    cell: Workcell, tasks: Sequence[PlannedTask], cut: Mapping[str, _Cut]
) -> list[TaskMotion]:
    """Return the path of every task, a waypoint at the end of every piece."""
    out = []
    last = {robot.name: robot.home for robot in cell.robots}
    for task in tasks:
        if task.kind != TRANSIT:
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
            # Whoever takes it stands and waits; it goes on when it has it.
            partner = [n for n, t in enumerate(tasks) if t.robot == h.holder]
            before = [n for n in partner if tasks[n].end <= tasks[k].start + SAME]
            later = [n for n in partner if tasks[n].start >= tasks[k].end - SAME]
            edges |= {(n, k) for n in before[-1:]} | {(k, n) for n in later[:1]}
    return edges


def _one_after_another(
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
