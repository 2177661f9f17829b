"""Schedule of a planned construction, for charts."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from planning.construction.planner import ConstructionPlan
from planning.construction.world.timeline import RobotTimeline

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
