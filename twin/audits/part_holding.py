"""Audit rule: a robot must hold certain placed parts until a given step or task is complete."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from operator import itemgetter

import numpy as np

from planning.tasks.task import Task, TaskKind
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from twin.audits.case import AuditCase, Violation
from twin.audits.motion.executed import Stay


def keeping_violations(
    case: AuditCase, ends: Mapping[str, float]
) -> Iterator[Violation]:
    """Yield parts that were released before the end of the task for which they had to be held.

    A part must be held where the scenario gives an end of the hold, or where the plan has its
    robot let go of it after another task. While it was carried its robot's tool was at it, which
    the grips say, and it does not move any more: so the tool stays at it as long as that robot
    stands.

    Args:
        case: what was executed, to its end. Without a log it is not known how long the work of
            machines had to be waited for.
        ends: when steps that have names were complete [s].
    """
    asked: dict[str, tuple[float, str]] = {
        part: (ends[step], step)
        for part, step in case.wanted.keeps.items()
        if step in ends
    }
    for part, task, end in _kept_until(case):
        asked[part] = max(asked.get(part, (end, task)), (end, task), key=itemgetter(0))
    for part, (end, until) in asked.items():
        for stay in _put_down(case, part):
            leaves = case.robots[str(stay.giver)].leaves(stay.t)
            if leaves < end - 1e-6:
                detail = f"is let go of {end - leaves:.3f} s before {until} is complete"
                who = str(stay.giver)
                yield Violation(leaves, end, part, who, 0.0, detail, "support")


def states_and_holds(
    case: AuditCase,
) -> Iterator[tuple[float, Mapping[str, Stay], set[str]]]:
    """Yield times of change with all object places, and parts held in place."""
    held = _held_in_place(case)
    ends = [until for _, until in held.values() if 0.0 < until <= case.end]
    for t, there in case.states(*ends):
        yield t, there, {k for k, (begin, end) in held.items() if begin <= t < end}


def _held_in_place(case: AuditCase) -> dict[str, tuple[float, float]]:
    """Return the intervals in which parts are held at their places [s].

    That is as long as the placing robot stands still, whatever the reason of the hold; where balance is
    looked
    at, and the rest of a plan was not executed, that may be any part.
    """
    wanted, begins = case.wanted, dict[str, Task]()
    parts = {*wanted.keeps, *(part for part, _ in _kept_in_plan(case.tpg))}
    if wanted.statics is not None:
        parts |= {place.object for place in wanted.places if place.object is not None}
        begins = {task.robot: task for task in reversed(case.tpg.tasks)}
    found = {
        part: (stay.t, case.robots[str(stay.giver)].leaves(stay.t))
        for part in parts
        for stay in _put_down(case, part)
    }
    for robot, task in begins.items():
        if task.kind == TaskKind.TRANSIT and task.object and not task.handlings:
            # The plan begins while it keeps hold of it.
            found.setdefault(task.object, (0.0, case.robots[robot].leaves(0.0)))
    return found


def _kept_in_plan(tpg: TemporalPlanGraph) -> Iterator[tuple[str, int]]:
    """Yield parts that the plan releases after a task of another robot, and that task.

    The way back of who keeps hold is a task of its own, about the part, in which nothing changes
    hands; of all others it belongs to the skill that places.
    """
    before: dict[int, Task] = {}
    latest: dict[str, Task] = {}
    for task in tpg.tasks:
        if task.robot in latest:
            before[task.index] = latest[task.robot]
        latest[task.robot] = task
    for first, second in tpg.dependencies.tolist():
        back, place = tpg.tasks[second], before.get(second)
        if place is None or back.handlings or back.object is None:
            continue
        if any((h.object, h.holder) == (back.object, None) for h in place.handlings):
            yield back.object, first


def _kept_until(case: AuditCase) -> Iterator[tuple[str, str, float]]:
    """Yield parts that the plan keeps held, with the releasing task's name and end."""
    tpg, spans = case.tpg, case.logged
    for part, first in _kept_in_plan(tpg):
        chain = tpg.chains[tpg.chain_index[tpg.tasks[first].robot]]
        nodes = np.flatnonzero(chain.task == first)
        if chain.robot in case.robots:
            rows = case.robots[chain.robot]
            end = float(rows.t[np.isin(rows.node, nodes)].max(initial=-np.inf))
        elif chain.robot in spans:
            end = float(spans[chain.robot].end[nodes].max())
        else:
            continue
        if np.isfinite(end):
            yield part, tpg.tasks[first].label, end


def _put_down(case: AuditCase, part: str) -> tuple[Stay, ...]:
    """Return the place where a part was put down last; None if it never was."""
    stays = case.stays.get(part, ())
    return tuple(
        stay for stay in stays if stay.holder is None and stay.giver in case.robots
    )[-1:]
