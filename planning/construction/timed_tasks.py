"""From a planned construction to tasks with timed paths: where both planning routes meet."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from planning.construction.building import Building, Work
from planning.construction.motion_pieces import cut_timeline
from planning.construction.part_contacts import Pairs, PartContacts, held_by
from planning.construction.problem import ConstructionProblem
from planning.construction.space_time_checker import HALVINGS, STEP
from planning.construction.timeline import SAME, RobotTimeline
from planning.motion_plan import MotionPlan, TaskMotion
from planning.task_graph import TRANSIT, AllowedContact, Handling, Task
from planning.transforms import Array, readonly


@dataclass(frozen=True)
class _Piece:
    """A task before it has a number."""

    task: Task
    motion: TaskMotion
    work: Work | None


def motion_plan(
    problem: ConstructionProblem,
    building: Building,
    *,
    step: float = STEP / 2**HALVINGS,
) -> MotionPlan:
    """Return a finished construction as tasks with timed paths.

    Between skills a robot has one transit; its way out of the others' way is a transit, too, as
    far as new work did not cut it short.

    Args:
        problem: what was built by whom.
        building: everything planned.
        step: cells of time; each becomes a node of the temporal plan graph [s].
    """
    pieces = [
        piece
        for robot in problem.cell.robots
        for piece in _pieces(building, robot.name, step)
    ]
    pieces.sort(key=lambda p: (float(p.motion.time[0]), float(p.motion.time[-1])))
    pieces = [
        replace(piece, task=replace(piece.task, index=k))
        for k, piece in enumerate(pieces)
    ]
    return MotionPlan(
        problem.cell,
        tuple(piece.task for piece in pieces),
        tuple(piece.motion for piece in pieces),
        _dependencies(problem, pieces),
        _allowed(problem, pieces),
    )


def _pieces(building: Building, robot: str, step: float) -> Iterator[_Piece]:
    line = building.world.robots[robot]
    own = sorted((w for w in building.work if w.robot == robot), key=lambda w: w.start)
    at, carried = float(line.time[0]), None
    for work in own:
        yield from _transit(
            line, at, work.start, step, f"to {work.part}", work, carried
        )
        yield _skill(line, work)
        at = work.end
        carried = None if work.kind != "pick" else work.part
    if own:
        yield from _transit(line, at, line.end, step, "HOME", own[-1], carried)


def _transit(
    line: RobotTimeline,
    start: float,
    end: float,
    step: float,
    label: str,
    work: Work,
    carried: str | None,
) -> Iterator[_Piece]:
    if end - start < SAME:
        return
    cut = cut_timeline(line, start, end, step)
    # Skills at both ends belong to no transit.
    inside = ~cut.whole & (cut.end > start + SAME) & (cut.start < end - SAME)
    time = np.concatenate([cut.start[inside][:1], cut.end[inside]])
    path = np.vstack([cut.q_a[inside][:1], cut.q_b[inside]])
    if not np.any(path[1:] != path[:-1]):
        return
    yield _Piece(
        Task(
            0, line.robot, TRANSIT, work.step, label, readonly(path[-1:]), (), carried
        ),
        TaskMotion(readonly(path), readonly(time)),
        None,
    )


def _skill(line: RobotTimeline, work: Work) -> _Piece:
    lo, hi = np.searchsorted(line.time, [work.start - SAME, work.end + SAME]).tolist()
    time, path = line.time[lo:hi], line.path[lo:hi]
    first = int(np.flatnonzero(_arrived(time, path))[-1])
    time, path = time[first:], path[first:]
    touch = int(np.searchsorted(time, work.touch - SAME))
    touch = _last_at(time, touch)
    words = {"pick": "pick", "place-down": "place", "handover": "hand over"}
    task = Task(
        0,
        line.robot,
        work.kind,
        work.step,
        f"{words[work.kind]} {work.part}",
        readonly(path[1:]),
        (Handling(work.part, touch, work.holder, readonly(work.pose)),),
        work.part,
    )
    return _Piece(task, TaskMotion(readonly(path), readonly(time)), work)


def _arrived(time: Array, path: Array) -> Array:
    """Tell which of the first waypoints of a skill are where and when it begins."""
    same = np.abs(time - time[0]) <= SAME
    return np.asarray(same & np.all(np.abs(path - path[0]) <= SAME, axis=1))


def _last_at(time: Array, k: int) -> int:
    """Return the last waypoint with the time of waypoint ``k``."""
    while k + 1 < len(time) and time[k + 1] - time[k] <= SAME:
        k += 1
    return k


def _dependencies(
    problem: ConstructionProblem, pieces: Sequence[_Piece]
) -> npt.NDArray[np.int64]:
    """Return which place waits for which: those that a part rests on, and handovers."""
    graph = problem.graph
    placed = {
        p.work.part: p for p in pieces if p.work is not None and p.work.holder is None
    }
    pairs: set[tuple[int, int]] = set()
    for name, piece in placed.items():
        assert piece.work is not None
        before = set(graph.carriers[name]) & set(placed) if problem.carried else set()
        if not before and name not in graph.ground:
            near = [placed[n] for n in graph.neighbours[name] if n in placed]
            first = min(near, key=lambda p: float(p.motion.time[-1]))
            before = {first.task.object or ""}
        for other in before:
            if placed[other].task.robot != piece.task.robot:
                pairs.add((placed[other].task.index, piece.task.index))
    return np.array(sorted(pairs), dtype=np.int64).reshape(-1, 2)


def _allowed(
    problem: ConstructionProblem, pieces: Sequence[_Piece]
) -> tuple[AllowedContact, ...]:
    """Return who may touch whom: pads what they hold, and parts what they lie on."""
    contacts = PartContacts(problem)
    tasks: dict[frozenset[str], set[int]] = {}

    def allow(pairs: Pairs, *indices: int) -> None:
        for pair in pairs:
            tasks.setdefault(pair, set()).update(indices)

    for piece in pieces:
        task = piece.task
        if task.object is None:
            continue
        part = problem.part(task.object)
        allow(held_by(task.robot, part), task.index)
        if task.kind == "pick":
            allow(contacts.at_start(part), task.index)
        elif task.kind == "place-down":
            allow(contacts.at_goal(part), task.index)
    return tuple(
        AllowedContact(min(pair), max(pair), frozenset(indices))
        for pair, indices in sorted(tasks.items(), key=lambda e: sorted(e[0]))
    )
