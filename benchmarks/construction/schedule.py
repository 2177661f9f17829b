"""Schedule of a planned construction, for charts.

The critical path of a structure: parts that can only be placed one after another.
"""

from __future__ import annotations

from collections.abc import Iterator
from graphlib import TopologicalSorter
from typing import NamedTuple

import numpy as np

from planning.construction.planner import ConstructionPlan
from planning.construction.world.timeline import RobotTimeline
from planning.contacts.precedence import PartGraph

DRIVE, CARRY, HOME = "without a part", "with a part", "out of the way"
"""Motions between skills."""

_SHORTEST = 0.2
"""Stands that are shorter than this are not told from motion [s]."""


class Span(NamedTuple):
    """A stretch of time: ``kind`` is a skill or a motion, ``part`` the step of the part."""

    robot: str
    kind: str
    start: float
    end: float
    step: int


def schedule(plan: ConstructionPlan) -> Iterator[Span]:
    """Yield all skills and motions, robot by robot, in order; what is left is waiting."""
    for robot in plan.problem.cell.robots:
        line = plan.building.world.robots[robot.name]
        work = [w for w in plan.building.work if robot.name in (w.robot, w.holder)]
        at, kind = 0.0, DRIVE
        step = 0
        for skill in sorted(work, key=lambda w: w.start):
            step = skill.step
            yield from _motions(line, kind, at, skill.start, step)
            yield Span(robot.name, skill.kind, skill.start, skill.end, step)
            at = skill.end
            kind = CARRY if skill.holder == robot.name else DRIVE
        yield from _motions(line, HOME, at, line.end, step)


def _motions(
    line: RobotTimeline, kind: str, start: float, end: float, step: int
) -> Iterator[Span]:
    """Yield the parts of a span in which a robot moves."""
    moves = np.any(np.diff(line.path, axis=0) != 0.0, axis=1)
    begin = last = None
    for a, b in zip(line.time[:-1][moves], line.time[1:][moves], strict=True):
        a, b = max(float(a), start), min(float(b), end)
        if b <= a:
            continue
        if begin is None or last is None:
            begin = a
        elif a - last > _SHORTEST:
            yield Span(line.robot, kind, begin, last, step)
            begin = a
        last = b
    if begin is not None and last is not None:
        yield Span(line.robot, kind, begin, last, step)


def longest_chain(graph: PartGraph, *, carried: bool = True) -> tuple[str, ...]:
    """Return parts that can only be placed one after another.

    However many robots build, their placements follow each other. With ``carried`` it is the
    longest chain of parts each of which rests on the one before; or the longest of the shortest
    ways from the ground, whichever has more parts.
    """
    best = _shortest_way_up(graph)
    if carried:
        best = max(best, _longest_pile(graph), key=len)
    return best


def _shortest_way_up(graph: PartGraph) -> tuple[str, ...]:
    chain: dict[str, tuple[str, ...]] = {
        part: (part,) for part in graph.neighbours if part in graph.ground
    }
    front = list(chain)
    last: tuple[str, ...] = ()
    for part in front:  # grows while it is gone through: breadth first
        last = chain[part]
        for near in sorted(graph.neighbours[part]):
            if near not in chain:
                chain[near] = (*chain[part], near)
                front.append(near)
    return last


def _longest_pile(graph: PartGraph) -> tuple[str, ...]:
    known: dict[str, tuple[str, ...]] = {}
    for part in TopologicalSorter(graph.carriers).static_order():
        below = (known[other] for other in sorted(graph.carriers[part]))
        known[part] = (*max(below, key=len, default=()), part)
    return max(known.values(), key=len, default=())
