"""Clearances in the fine check: bodies, spans of time and least distances.

In a span of time nobody takes or puts down anything, and no skill begins or ends: so it is
settled for all of it what moves with whom, what rests, and what may touch.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import combinations, pairwise

import numpy as np

from benchmarks.construction.fine_check.walk import Group, Limit, Measurer, Motion
from planning.cell.workcell import Clearances
from planning.construction.planner import ConstructionPlan
from planning.construction.world.timeline import ObjectChange
from planning.progress import Progress
from planning.transforms import Array
from scheduling.witness.parts import ConvexPart, measure, resting_parts

_PRESSED = 0.002
"""A pad may be this deep in a part, and a part in the hand in what it touches [m]."""


def measure_clearances(
    plan: ConstructionPlan,
    motions: Mapping[str, Motion],
    progress: Progress | None = None,
) -> Measurer:
    """Measure robots among what rests, each by itself, and all among each other.

    Args:
        plan: the plan.
        motions: of its robots, by name.
        progress: told how many robots and pairs of robots are done, of how many.
    """
    spans = _Spans(plan, motions)
    measurer = Measurer()
    clearances = plan.problem.cell.clearances
    walks: list[tuple[str, ...]] = [(name,) for name in motions]
    walks += combinations(motions, 2)
    for k, robots in enumerate(walks):
        if progress is not None:
            progress(k, len(walks))
        for start, end in spans.of(robots):
            groups = [spans.robot(name, start) for name in robots]
            touch = [spans.touching(name, start, end) for name in robots]
            samples = spans.samples(groups, start, end)
            if len(robots) == 2:
                limit = _between(robots, touch[0] | touch[1], clearances)
                measurer.walk(groups[0], groups[1], samples, limit)
            else:
                limit = _among_still(robots[0], touch[0], clearances)
                measurer.walk(groups[0], spans.still(start), samples, limit)
                measurer.walk(groups[0], groups[0], samples, _alone(groups[0]))
    if progress is not None:
        progress(len(walks), len(walks))
    return measurer


def _half(part: ConvexPart) -> Array:
    """Return half the edges of a box about the origin of a part's frame that holds it [m]."""
    box = part.shape.aabb_local
    return np.maximum(np.abs(np.array(box.min_)), np.abs(np.array(box.max_)))


class _Spans:
    """Cuts the time of a plan, and says what is where in a span."""

    def __init__(self, plan: ConstructionPlan, motions: Mapping[str, Motion]) -> None:
        self._cell, self._motions = plan.problem.cell, motions
        self._work = plan.building.work
        lines = plan.building.world.objects
        self._changes = {name: line.changes for name, line in lines.items()}
        self._end = max(motion.end for motion in motions.values())
        self._fixtures = [
            part
            for f in self._cell.fixtures
            for part in resting_parts(f.name, f.shape, f.pose)
        ]

    def of(self, robots: Sequence[str]) -> list[tuple[float, float]]:
        """Return the spans for one robot among what rests, or for two."""
        times = {
            change.time
            for changes in self._changes.values()
            for change, before in zip(changes, (None, *changes), strict=False)
            if len(robots) == 1
            or change.holder in robots
            or (before is not None and before.holder in robots)
        }
        for work in self._work:
            if work.robot in robots or work.holder in robots:
                times |= {work.start, work.end}
        inside = sorted(t for t in times if 0.0 < t < self._end)
        return list(pairwise([0.0, *inside, self._end]))

    def samples(self, groups: Sequence[Group], start: float, end: float) -> list[float]:
        """Return when to look at moving groups."""
        times: set[float] = set()
        for group in groups:
            assert group.motion is not None
            times |= set(group.motion.samples(group.parts, start, end).tolist())
        return sorted(times)

    def robot(self, robot: str, t: float) -> Group:
        """Return a robot and what it holds after what happens at ``t``."""
        motion = self._motions[robot]
        loads = [
            load
            for name, changes in self._changes.items()
            if (last := _last(changes, t)) is not None and last.holder == robot
            for load in motion.robot.loads(
                name, self._cell.object(name).shape, np.asarray(last.pose)
            )
        ]
        return Group(motion, (*motion.robot.parts, *loads))

    def still(self, t: float) -> Group:
        """Return the fixtures, and the parts that nobody holds after what happens at ``t``."""
        parts = list(self._fixtures)
        for item in self._cell.objects:
            last = _last(self._changes[item.name], t)
            if last is None or last.holder is None:
                pose = np.asarray(item.start if last is None else last.pose)
                parts += resting_parts(item.name, item.shape, pose)
        return Group(None, tuple(parts), np.array([_half(part) for part in parts]))

    def touching(self, robot: str, start: float, end: float) -> frozenset[str]:
        """Return the parts with which a robot has a skill in a span."""
        return frozenset(
            str(w.object)
            for w in self._work
            if robot in (w.robot, w.holder) and w.start <= start and end <= w.end
        )


def _among_still(robot: str, touch: frozenset[str], clearances: Clearances) -> Limit:
    """Return the least distances of a robot and what rests.

    A pad may touch the part that it picks or places; that part, in the hand, what it lies on.
    """

    def limit(moving: ConvexPart, still: ConvexPart) -> float:
        if moving.joint < 0:
            return -math.inf  # what is bolted down may stand in the floor
        pad = moving.entity == f"{robot}/tool" and still.entity in touch
        if pad or moving.entity in touch:
            return -_PRESSED
        return clearances.robot_object

    return limit


def _between(
    robots: Sequence[str], touch: frozenset[str], clearances: Clearances
) -> Limit:
    """Return the least distances of two robots and what they carry.

    Pads may touch what changes hands.
    """
    pads = {f"{robot}/tool" for robot in robots}

    def limit(one: ConvexPart, other: ConvexPart) -> float:
        names = {one.entity, other.entity}
        return -_PRESSED if names & touch and names & pads else clearances.robot_robot

    return limit


def _alone(group: Group) -> Limit:
    """Return the least distances of one robot's bodies: neighbours in the chain are left out."""
    frames = dict(zip(map(id, group.parts), group.frames(np.zeros(1))[0], strict=True))

    def limit(one: ConvexPart, other: ConvexPart) -> float:
        if "/" not in other.entity:
            return -math.inf if one.entity.endswith("/tool") else 0.0
        if abs(one.joint - other.joint) <= 1:
            return -math.inf
        at_home = measure(one, frames[id(one)], other, frames[id(other)])
        return 0.0 if at_home > 0.0 else -math.inf

    return limit


def _last(changes: Sequence[ObjectChange], t: float) -> ObjectChange | None:
    """Return the last change up to a time, that time included."""
    return next((c for c in reversed(changes) if c.time <= t), None)
