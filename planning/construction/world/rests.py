"""Time spans in which objects are at rest."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planning.construction.world.fixed_world import FixedWorld
from planning.construction.world.timeline import SAME, RobotTimeline
from planning.transforms import Transform


class Rest(NamedTuple):
    """An object at rest at one pose during a span of time.

    Attributes:
        object: its name.
        start, end: when [s]: from the beginning of the skill that puts it there to the end of
            the skill that takes it away.
        pose: of its centre in the world.
    """

    object: str
    start: float
    end: float
    pose: Transform


def rests_of(world: FixedWorld, name: str) -> list[Rest]:
    """Return the rests of an object, in order."""
    item = world.cell.object(name)
    changes = world.objects[name].changes
    out: list[Rest] = []
    since, pose = (-np.inf, item.start)
    resting = not item.later
    holder: str | None = None
    for change in changes:
        if change.holder is None:
            begin = change.time
            if holder is not None:
                begin = _skill_at(world.robots[holder], change.time)[0]
            since, pose, resting = begin, change.pose, True
        elif resting:
            end = _skill_at(world.robots[change.holder], change.time)[1]
            out.append(Rest(name, since, end, pose))
            resting = False
        holder = change.holder
    if resting:
        out.append(Rest(name, since, np.inf, pose))
    return out


def _skill_at(line: RobotTimeline, t: float) -> tuple[float, float]:
    """Return the skill of a robot that goes on at time ``t``, ``(t, t)`` where there is none."""
    for a, b in line.skills:
        if a - SAME <= t <= b + SAME:
            return a, b
    return t, t
