"""Clearances in the fine check: bodies, spans of time and least distances.

In a span of time nobody takes or puts down anything, and no skill begins or ends: so it is
settled for all of it what moves with whom, what rests, and what may touch.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from itertools import combinations, pairwise

import numpy as np

from benchmarks.construction.fine_check.timed_motion import (
    MovingRobot,
    TimedMotion,
    piece_times,
)
from planning.cell.workcell import Clearances
from planning.construction.planner import ConstructionPlan
from planning.construction.world.timeline import ObjectChange
from planning.progress import Progress
from planning.transforms import Array, Indices
from scheduling.witness.measuring import Measuring
from scheduling.witness.motion import Motion
from scheduling.witness.own_motions import OwnMotions
from scheduling.witness.parts import TOLERANCE, ConvexPart, measure, resting_parts
from scheduling.witness.sweeps import SweepBounds, close_pairs

_PRESSED = 0.002
"""A pad may be this deep in a part, and a part in the hand in what it touches [m]."""

_NEAR = 0.05
"""Least distances are looked for below this [m]."""

_AT_REST = np.zeros((2, 0)), np.tile(np.eye(4), (2, 1, 1))
"""Knots and frames of what does not move."""

Limit = Callable[[ConvexPart, ConvexPart], float]
"""Least distance of two bodies [m]; minus infinity for a pair that is not looked at."""


def measure_clearances(
    plan: ConstructionPlan,
    motions: Mapping[str, TimedMotion],
    progress: Progress | None = None,
) -> ClearanceCheck:
    """Look at robots among what rests, each by itself, and all among each other.

    Args:
        plan: the plan.
        motions: of its robots, by name.
        progress: told how many robots and pairs of robots are done, of how many.
    """
    spans, check = _Spans(plan, motions), ClearanceCheck()
    clearances = plan.problem.cell.clearances
    walks: list[tuple[str, ...]] = [(name,) for name in motions]
    walks += combinations(motions, 2)
    for k, robots in enumerate(walks):
        if progress is not None:
            progress(k, len(walks))
        for start, end in spans.of(robots):
            touch = [spans.touching(name, start, end) for name in robots]
            times, moving = spans.moving(robots, start, end)
            if len(robots) == 2:
                limit = _between(robots, touch[0] | touch[1], clearances)
                check.between(moving[0], moving[1], times, limit)
            else:
                limit = _among_still(robots[0], touch[0], clearances)
                check.among(moving[0], spans.still(start), times, limit)
                check.alone(moving[0], times, _alone(moving[0]))
    if progress is not None:
        progress(len(walks), len(walks))
    return check


class ClearanceCheck:
    """Finds what comes too close, at every moment.

    Attributes:
        found: what is too close, and from when on; each pair once a span [s].
        nearest: least distances of bodies that may not touch, by whether they are of two robots,
            of those below ``_NEAR``; a robot by itself is not counted [m].
    """

    def __init__(self) -> None:
        self.found: list[tuple[float, str]] = []
        self.nearest = {True: _NEAR, False: _NEAR}
        self._measuring = Measuring()

    @property
    def measured(self) -> int:
        """Number of distances measured."""
        return self._measuring.count

    def least(self, robots: bool) -> float:
        """Return the least distance of two robots or of others, infinite if none are near [m]."""
        found = self.nearest[robots]
        return found if found < _NEAR else math.inf

    def between(
        self, a: MovingRobot, b: MovingRobot, times: Array, limit: Limit
    ) -> None:
        """Look at two robots that move at the same time.

        Args:
            a, b: the robots, cut at the same times.
            times: knots of their pieces [s].
            limit: least distances.
        """
        least = np.array([[limit(p, q) for q in b.parts] for p in a.parts])
        windows = a.pieces, a.pieces + 1
        limits = self._limits(least, True)
        for close in close_pairs(a.sweeps, b.sweeps, windows, limits):
            indices = close.x, close.y, close.i, close.i
            self._look((a.motions, b.motions), indices, least, times, True)

    def among(
        self, robot: MovingRobot, still: Sequence[Motion], times: Array, limit: Limit
    ) -> None:
        """Look at a robot among what rests.

        Args:
            robot: the robot.
            still: what rests.
            times: knots of its pieces [s].
            limit: least distances.
        """
        least = np.array([[limit(p, r.part) for r in still] for p in robot.parts])
        one = np.zeros(1, dtype=np.int64)
        low, high = (
            np.stack(side, axis=1)
            for side in zip(*(rest.extents(one) for rest in still), strict=True)
        )
        count = len(robot.pieces)
        windows = np.repeat(one, len(still)), np.repeat(one + count, len(still))
        limits = self._limits(least, False).max(axis=1)[None]
        sweeps = SweepBounds((low,), (high,))
        for close in close_pairs(sweeps, robot.sweeps, windows, limits):
            indices = close.y, close.i, close.j, np.zeros_like(close.j)
            self._look((robot.motions, still), indices, least, times, False)

    def alone(self, robot: MovingRobot, times: Array, limit: Limit) -> None:
        """Look at a robot by itself.

        Args:
            robot: the robot.
            times: knots of its pieces [s].
            limit: least distances.
        """
        own = OwnMotions(robot.motion.robot, robot.knots, robot.frames)
        for pair in combinations(robot.parts, 2):
            least = limit(*pair)
            if least > -math.inf:
                inner, outer = sorted(pair, key=lambda part: part.joint)
                both, pieces, bound = (inner, outer), robot.pieces, least - TOLERANCE
                self._note(
                    times,
                    pair,
                    own.too_close(self._measuring, both, pieces, bound, pieces),
                )

    def _limits(self, least: Array, robots: bool) -> Array:
        """Return distances up to which pairs of bodies are looked at: also those nearer than all before."""
        return np.where(least >= 0.0, np.maximum(least, self.nearest[robots]), least)

    def _look(
        self,
        motions: tuple[Sequence[Motion], Sequence[Motion]],
        indices: tuple[Indices, Indices, Indices, Indices],
        least: Array,
        times: Array,
        robots: bool,
    ) -> None:
        """Look at bodies in the pieces in which they may come near each other.

        Args:
            motions: of the bodies of either side.
            indices: of bodies of either side, and of a piece of each, shape (k,) each.
            least: distances of bodies, shape (bodies, bodies) [m].
            times: knots of the pieces of the first side [s].
            robots: whether both sides are robots.
        """
        x, y, rows, columns = indices
        for i, j in sorted({*zip(x.tolist(), y.tolist(), strict=True)}):
            if (limit := float(least[i, j])) == -math.inf:
                continue
            here, one, other = (x == i) & (y == j), motions[0][i], motions[1][j]
            pairs, every = (
                (rows[here], columns[here]),
                np.arange(np.count_nonzero(here)),
            )
            hits = self._measuring.too_close(
                one, other, pairs, limit - TOLERANCE, every, lockstep=True
            )
            found = ((int(pairs[0][k]), gap) for k, gap, _ in hits)
            self._note(times, (one.part, other.part), found)
            if limit >= 0.0:  # contacts that are allowed do not count
                self.nearest[robots] = self._measuring.closest(
                    one, other, pairs, self.nearest[robots], lockstep=True
                )

    def _note(
        self,
        times: Array,
        pair: tuple[ConvexPart, ConvexPart],
        hits: Iterable[tuple[int, float]],
    ) -> None:
        """Note the first of the pieces in which two bodies come too close, if there is one."""
        if (first := min(hits, default=None)) is None:
            return
        piece, gap = first
        much = f"{gap * 1e3:.1f} mm" if gap > 0 else f"overlap by {-gap * 1e3:.1f} mm"
        names = " and ".join(part.entity for part in pair)
        self.found.append((float(times[piece]), f"{names}: {much}"))


class _Spans:
    """Cuts the time of a plan, and says what is where in a span."""

    def __init__(
        self, plan: ConstructionPlan, motions: Mapping[str, TimedMotion]
    ) -> None:
        self._cell, self._motions = plan.problem.cell, motions
        self._work = plan.building.work
        lines = plan.building.world.objects
        self._changes = {name: line.changes for name, line in lines.items()}
        self._end = max(motion.end for motion in motions.values())
        self._fixtures = [
            Motion(None, part, *_AT_REST)
            for f in self._cell.fixtures
            for part in resting_parts(f.name, f.shape, f.pose)
        ]
        self._placed = cache(self._at_rest)

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

    def moving(
        self, robots: Sequence[str], start: float, end: float
    ) -> tuple[Array, list[MovingRobot]]:
        """Return robots and what they hold after what happens at ``start``, cut at the same times.

        Returns:
            Times of the cuts, shape (s + 1,) [s], and the robots in pieces between them.
        """
        parts = [(self._motions[name], self._parts(name, start)) for name in robots]
        times = piece_times(parts, start, end)
        return times, [MovingRobot(motion, own, times) for motion, own in parts]

    def _parts(self, robot: str, t: float) -> list[ConvexPart]:
        own = self._motions[robot].robot
        loads = [
            load
            for name, changes in self._changes.items()
            if (last := _last(changes, t)) is not None and last.holder == robot
            for load in own.loads(
                name, self._cell.object(name).shape, np.asarray(last.pose)
            )
        ]
        return [*own.parts, *loads]

    def still(self, t: float) -> list[Motion]:
        """Return the fixtures, and the parts that nobody holds after what happens at ``t``."""
        there = [
            self._placed(item.name, self._number(item.name, t))
            for item in self._cell.objects
        ]
        return [*self._fixtures, *(motion for some in there for motion in some)]

    def _number(self, name: str, t: float) -> int:
        """Return how many changes an object has had up to a time, that time included."""
        return sum(change.time <= t for change in self._changes[name])

    def _at_rest(self, name: str, number: int) -> list[Motion]:
        """Return an object after so many changes, nothing where it is held."""
        item = self._cell.object(name)
        last = self._changes[name][number - 1] if number else None
        if last is not None and last.holder is not None:
            return []
        pose = np.asarray(item.start if last is None else last.pose)
        parts = resting_parts(name, item.shape, pose)
        return [Motion(None, part, *_AT_REST) for part in parts]

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


def _alone(robot: MovingRobot) -> Limit:
    """Return the least distances of one robot's bodies: neighbours in the chain are left out."""
    geometry = robot.motion.robot
    frames = geometry.joint_frames(robot.motion.at(np.zeros(1))[0])

    def limit(one: ConvexPart, other: ConvexPart) -> float:
        if "/" not in other.entity:
            return -math.inf if one.entity.endswith("/tool") else 0.0
        if abs(one.joint - other.joint) <= 1:
            return -math.inf
        at_start = measure(one, frames[one.joint + 1], other, frames[other.joint + 1])
        return 0.0 if at_start > 0.0 else -math.inf

    return limit


def _last(changes: Sequence[ObjectChange], t: float) -> ObjectChange | None:
    """Return the last change up to a time, that time included."""
    return next((c for c in reversed(changes) if c.time <= t), None)
