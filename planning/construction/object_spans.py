"""What robots hold and where objects lie, from when to when."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from planning.construction.timeline import SAME, RobotTimeline
from planning.transforms import Transform
from planning.workcell import Workcell

if TYPE_CHECKING:
    from planning.construction.fixed_world import FixedWorld

Hand = tuple[tuple[str, bytes], ...]
"""What a robot holds: names of objects, and their poses in the flange frame as bytes."""

HandChange = tuple[float, Hand]
"""From when on a robot holds what [s]."""


def hand_changes(world: FixedWorld, robot: str) -> list[HandChange]:
    """Return what a robot holds from which times on, the first from ever (minus infinity)."""
    spans: list[tuple[float, float, str, bytes]] = []
    for name, line in world.objects.items():
        for k, change in enumerate(line.changes):
            if change.holder == robot:
                last = k + 1 == len(line.changes)
                end = np.inf if last else line.changes[k + 1].time
                spans.append((change.time, end, name, change.pose.tobytes()))
    times = sorted({t for a, b, _, _ in spans for t in (a, b) if np.isfinite(t)})
    out: list[HandChange] = []
    for t in [-np.inf, *times]:
        hand = tuple((name, pose) for a, b, name, pose in spans if a <= t < b)
        if not out or out[-1][1] != hand:
            out.append((t, hand))
    return out


class Rest(NamedTuple):
    """An object lies somewhere.

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
    """Return where and when an object lies, in order."""
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


def pose_of(hand: bytes) -> Transform:
    """Return a pose from its bytes."""
    return np.frombuffer(hand, dtype=np.float64).reshape(4, 4)


def entity_numbers(cell: Workcell) -> dict[str, int]:
    """Return the number of every entity: arm and tool of each robot, fixtures, objects."""
    names = [f"{r.name}/{group}" for r in cell.robots for group in ("arm", "tool")]
    names += [f.name for f in cell.fixtures] + [o.name for o in cell.objects]
    return {name: k for k, name in enumerate(names)}
