"""Clearances between all pairs of pieces that may happen at once, measured with coal."""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Iterable
from itertools import combinations, product

import numpy as np

from planning.transforms import Array, Transform
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.verification.ancestors import Precedence
from scheduling.verification.bodies import RobotBodies
from scheduling.verification.findings import (
    Key,
    Moment,
    Problem,
    conflict,
    key_of,
    moment_of,
    without_repeats,
)
from scheduling.verification.near_pieces import (
    close_pairs,
    over_before,
    unsettled,
    while_there,
)
from scheduling.verification.object_places import Resting, object_histories
from scheduling.verification.reference import (
    TOLERANCE,
    Part,
    ReferenceRobot,
    measure,
    resting_part,
)

_FINEST = 1e-5

Progress = Callable[[int, int], None]
"""Called with the pairs of robots (or robots and resting things) done so far, and their number."""


class ClearanceCheck:
    """Measures all pairs of pieces that may happen at once.

    Args:
        tpg: the plan.
        limit: stop after so many problems.
        progress: told how far it has come.

    Attributes:
        problems: found so far.
        pairs: pairs of pieces looked at.
        least: least distances measured, by whether they are between two robots [m].
    """

    def __init__(
        self, tpg: TemporalPlanGraph, limit: int, progress: Progress | None
    ) -> None:
        self.tpg, self.limit, self.progress = tpg, limit, progress
        self.problems: list[Problem] = []
        self.pairs = 0
        self.least = {True: math.inf, False: math.inf}
        self.allowed: dict[frozenset[str], list[frozenset[int]]] = {}
        for contact in tpg.allowed:
            pair = frozenset((contact.first, contact.second))
            self.allowed.setdefault(pair, []).append(contact.tasks)

    def run(self, precedence: Precedence) -> None:
        """Check that whatever may happen at once keeps apart."""
        tpg, cell = self.tpg, self.tpg.cell
        geometry = {placed.name: ReferenceRobot(placed) for placed in cell.robots}

        def flange(chain: int, node: int) -> Transform:
            c = tpg.chains[chain]
            q = c.start if node == 0 else c.waypoints[c.first[node] - 1]
            return geometry[c.robot].flange_pose(q)

        carried, resting = object_histories(tpg, flange)
        robots = [
            RobotBodies(tpg, placed, geometry[placed.name], carried)
            for placed in cell.robots
        ]
        pairs = list(combinations(robots, 2))
        total = len(pairs) + len(robots)
        for done, (a, b) in enumerate(pairs, 1):
            self._robots(a, b, precedence)
            self._tell(done, total)
        for done, robot in enumerate(robots, len(pairs) + 1):
            for rest in resting:
                self._rest(robot, rest, precedence)
            self._tell(done, total)

    def _tell(self, done: int, total: int) -> None:
        if self.progress is not None:
            self.progress(done, total)

    def _robots(self, a: RobotBodies, b: RobotBodies, precedence: Precedence) -> None:
        # Per piece of one robot: nodes of the other that are over before it.
        past_a = over_before(a, b, precedence)
        past_b = over_before(b, a, precedence)
        low = np.searchsorted(b.pieces.end, past_b)
        high = np.searchsorted(past_a, a.pieces.end, side="right")
        self.pairs += int(np.maximum(high - low, 0).sum())
        seen: dict[Key, Problem] = {}
        clearances = self.tpg.cell.clearances
        for x, y in product(a.bodies, b.bodies):
            both = x.robot and y.robot
            limit = clearances.robot_robot if both else clearances.robot_object
            for close in close_pairs(a.pieces, x, b.pieces, y, past_a, past_b, limit):
                if len(self.problems) + len(seen) >= self.limit:
                    break
                for i, j in unsettled(a, x, b, y, close, limit):
                    key = key_of(a.pieces, i, b.pieces, j)
                    if key in seen or self._may_touch(
                        x.part.entity,
                        y.part.entity,
                        a.pieces.tasks[i].tolist(),
                        b.pieces.tasks[j].tolist(),
                    ):
                        continue
                    found = self._closer(
                        (a, x.part, i), (b, y.part, j), limit, between_robots=both
                    )
                    if found is not None:
                        first, second = moment_of(a, x.part, i), moment_of(b, y.part, j)
                        seen[key] = conflict(first, second, found)
        self.problems += without_repeats(seen)

    def _rest(self, robot: RobotBodies, rest: Resting, precedence: Precedence) -> None:
        part = resting_part(rest.object, rest.size, rest.pose)
        fixture = any(f.name == rest.object for f in self.tpg.cell.fixtures)
        there = while_there(robot, rest, precedence)
        self.pairs += int(there.sum())
        limit = self.tpg.cell.clearances.robot_object
        world = np.eye(4)
        inverse = rest.pose[:3, :3]
        seen: dict[Key, Problem] = {}
        for x in robot.bodies:
            if x.part.entity == rest.object or (fixture and x.part.joint < 0):
                continue
            local = (x.centre - rest.pose[:3, 3]) @ inverse
            out = np.linalg.norm(
                np.maximum(np.abs(local) - 0.5 * rest.size, 0.0), axis=1
            )
            close = (out < x.radius + limit) & there[x.pieces]
            for i in x.pieces[close].tolist():
                tasks = robot.pieces.tasks[i].tolist()
                key = (
                    int(robot.pieces.node[i]),
                    -1,
                    bool(robot.pieces.standing[i]),
                    True,
                )
                if key in seen or self._may_touch(
                    x.part.entity, rest.object, tasks, rest.tasks
                ):
                    continue
                found = self._closer((robot, x.part, i), (None, part, world), limit)
                if found is not None:
                    first = moment_of(robot, x.part, i)
                    second = Moment(None, -1, -1, True, rest.object)
                    seen[key] = conflict(first, second, found, kind="rest")
        self.problems += without_repeats(seen)

    def _may_touch(
        self, x: str, y: str, x_tasks: Iterable[int], y_tasks: Iterable[int] | None
    ) -> bool:
        if x == y:
            return True
        for tasks in self.allowed.get(frozenset((x, y)), ()):
            if tasks.isdisjoint(x_tasks):
                continue
            if y_tasks is None or not tasks.isdisjoint(y_tasks):
                return True
        return False

    def _closer(
        self,
        first: tuple[RobotBodies, Part, int],
        second: tuple[RobotBodies, Part, int] | tuple[None, Part, Array],
        limit: float,
        *,
        between_robots: bool = False,
    ) -> float | None:
        """Return a distance below the limit, None if there is none.

        Both motions are halved until the sample in the middle decides: either it is too close,
        or it is further away than both can move from there.
        """
        a, part_a, i = first
        spans = [(a.pieces.q_a[i], a.pieces.q_b[i])]
        if second[0] is not None:
            b, part_b, j = second
            spans.append((b.pieces.q_a[j], b.pieces.q_b[j]))
            frame_b = b.frames[j, part_b.joint + 1]
        else:
            _, part_b, frame_b = second
        count = 0
        todo = [(0.0, count, spans, a.frames[i, part_a.joint + 1], frame_b)]
        while todo:  # what may be closest first
            _, _, spans, frame_a, frame_b = heapq.heappop(todo)
            gap = measure(part_a, frame_a, part_b, frame_b)
            self.least[between_robots] = min(self.least[between_robots], gap)
            if gap < limit - TOLERANCE:
                return gap
            moved = [
                0.5 * float(np.abs(end - start) @ part.weight)
                for (start, end), part in zip(spans, (part_a, part_b), strict=False)
            ]
            if gap - sum(moved) >= limit - TOLERANCE or max(moved) < _FINEST:
                continue
            cut = int(np.argmax(moved))
            start, end = spans[cut]
            middle = 0.5 * (start + end)
            for half in ((start, middle), (middle, end)):
                q = 0.5 * (half[0] + half[1])
                count += 1
                if cut == 0:
                    frame = a.robot.joint_frames(q)[part_a.joint + 1]
                    entry = ([half, *spans[1:]], frame, frame_b)
                else:
                    assert second[0] is not None
                    frame = second[0].robot.joint_frames(q)[part_b.joint + 1]
                    entry = ([spans[0], half], frame_a, frame)
                heapq.heappush(todo, (gap - sum(moved), count, *entry))
        return None
