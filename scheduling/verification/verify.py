"""Independent, slow proof that a saved plan keeps its guarantee (``twin verify``).

Nothing here is shared with the code that builds the graph: order comes from sets of ancestors,
geometry from pinocchio's own reading of the URDF files and coal's exact shapes, occupancy from
dense samples grown by the motion between them; no capsules, no clocks, no conflict search.
Checked are the structure, and the invariant: (a) nodes of two robots that come too close are
ordered, (b) so are a node and a robot that stands, (c) and a node and an object at rest.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import combinations, product
from typing import NamedTuple

import numpy as np

from planning.transforms import Array, Transform
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.verification.bodies import (
    Body,
    RobotBodies,
    close_pairs,
    over_before,
    unsettled,
    while_there,
)
from scheduling.verification.graph_structure import (
    Moment,
    Precedence,
    Problem,
    check_structure,
)
from scheduling.verification.object_places import Resting, object_histories
from scheduling.verification.reference import (
    TOLERANCE,
    Part,
    ReferenceRobot,
    measure,
    resting_part,
)

__all__ = ["Moment", "Problem", "VerificationReport", "verify_plan"]


_FINEST = 1e-5

_Key = tuple[int, int, bool, bool]
"""Nodes of both sides, and whether each robot stands before its node."""

Progress = Callable[[int, int], None]
"""Called with the pairs of robots (or robots and resting things) done so far, and their number."""


@dataclass(frozen=True)
class VerificationReport:
    """Outcome of a verification.

    Attributes:
        pairs_checked: pairs of pieces that may happen at once (motions, stands, rests).
        min_distance_robots_m: least distance measured between two robots in such pairs;
            infinite if none came near enough to be measured [m].
        min_distance_objects_m: likewise between a robot or its load and anything else, where
            no contact is allowed [m].
        problems: empty for a plan that keeps its guarantee; cut off at ``limit``.
    """

    pairs_checked: int
    min_distance_robots_m: float
    min_distance_objects_m: float
    problems: tuple[Problem, ...]

    @property
    def ok(self) -> bool:
        """True when nothing is wrong."""
        return not self.problems


def verify_plan(
    tpg: TemporalPlanGraph,
    *,
    limit: int = 100,
    progress: Progress = lambda done, total: None,
) -> VerificationReport:
    """Check a plan from scratch.

    Args:
        tpg: the plan.
        limit: stop after so many problems.
        progress: told how far it has come.
    """
    precedence, problems = check_structure(tpg)
    check = _ClearanceCheck(tpg, limit - len(problems), progress)
    if precedence is not None:
        check.run(precedence)
    return VerificationReport(
        check.pairs,
        check.least[True],
        check.least[False],
        tuple([*problems, *check.problems][:limit]),
    )


class _ClearanceCheck:
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

    def __init__(self, tpg: TemporalPlanGraph, limit: int, progress: Progress) -> None:
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
            self.progress(done, total)
        for done, robot in enumerate(robots, len(pairs) + 1):
            for rest in resting:
                self._rest(robot, rest, precedence)
            self.progress(done, total)

    def _robots(self, a: RobotBodies, b: RobotBodies, precedence: Precedence) -> None:
        # Per piece of one robot: nodes of the other that are over before it.
        past_a = over_before(a.chain, b, precedence)
        past_b = over_before(b.chain, a, precedence)
        low = np.searchsorted(b.pieces.end, past_b)
        high = np.searchsorted(past_a, a.pieces.end, side="right")
        self.pairs += int(np.maximum(high - low, 0).sum())
        seen: dict[_Key, Problem] = {}
        clearances = self.tpg.cell.clearances
        for x, y in product(a.bodies, b.bodies):
            loaded = x.load or y.load
            limit = clearances.robot_object if loaded else clearances.robot_robot
            for close in close_pairs(x, y, past_a, past_b, limit):
                if len(self.problems) + len(seen) >= self.limit:
                    break
                for i, j in unsettled(x, y, close, limit):
                    self._check((_side(x, i), _side(y, j)), limit, seen, not loaded)
        self.problems += _without_repeats(seen)

    def _rest(self, robot: RobotBodies, rest: Resting, precedence: Precedence) -> None:
        still = _Side(
            None,
            resting_part(rest.object, rest.size, rest.pose),
            np.zeros(0),
            np.zeros(0),
            np.eye(4),
            Moment(None, -1, -1, True, rest.object),
            rest.tasks,
        )
        fixture = any(f.name == rest.object for f in self.tpg.cell.fixtures)
        there = while_there(robot, rest, precedence)
        self.pairs += int(there.sum())
        limit = self.tpg.cell.clearances.robot_object
        inverse = rest.pose[:3, :3]
        seen: dict[_Key, Problem] = {}
        for x in robot.bodies:
            if fixture and x.part.joint < 0:
                continue
            local = (x.centre - rest.pose[:3, 3]) @ inverse
            out = np.linalg.norm(
                np.maximum(np.abs(local) - 0.5 * rest.size, 0.0), axis=1
            )
            close = (out < x.radius + limit) & there[x.pieces]
            for i in x.pieces[close].tolist():
                self._check((_side(x, i), still), limit, seen, False)
        self.problems += _without_repeats(seen)

    def _check(
        self,
        sides: tuple[_Side, _Side],
        limit: float,
        seen: dict[_Key, Problem],
        between_robots: bool,
    ) -> None:
        """Note two sides that come too close, unless they may or are noted already."""
        first, second = sides[0].moment, sides[1].moment
        key = (first.node, second.node, first.standing, second.standing)
        if key not in seen and not self._may_touch(*sides):
            found = self._closer(sides, limit, between_robots)
            if found is not None:
                seen[key] = _conflict(first, second, found)

    def _may_touch(self, a: _Side, b: _Side) -> bool:
        x, y = a.part.entity, b.part.entity
        return x == y or any(
            (a.tasks is None or not tasks.isdisjoint(a.tasks))
            and (b.tasks is None or not tasks.isdisjoint(b.tasks))
            for tasks in self.allowed.get(frozenset((x, y)), ())
        )

    def _closer(
        self, sides: tuple[_Side, _Side], limit: float, between_robots: bool
    ) -> float | None:
        """Return a distance below the limit, None if there is none.

        Both motions are halved until the sample in the middle decides: either it is too close,
        or it is further away than both can move from there.
        """
        count = 0
        todo = [(0.0, count, sides)]
        while todo:  # what may be closest first
            _, _, sides = heapq.heappop(todo)
            a, b = sides
            gap = measure(a.part, a.frame, b.part, b.frame)
            self.least[between_robots] = min(self.least[between_robots], gap)
            if gap < limit - TOLERANCE:
                return gap
            moved = a.moved(), b.moved()
            if gap - sum(moved) >= limit - TOLERANCE or max(moved) < _FINEST:
                continue
            if moved[0] >= moved[1]:
                halves = [(half, b) for half in a.halves()]
            else:
                halves = [(a, half) for half in b.halves()]
            for half in halves:
                count += 1
                heapq.heappush(todo, (gap - sum(moved), count, half))
        return None


class _Side(NamedTuple):
    """A part in a straight motion of its robot.

    Attributes:
        robot: the robot, None for what rests in the world.
        part: the part.
        q_a, q_b: where the motion begins and ends, shape (n,).
        frame: pose of the part's joint in the middle of the motion, shape (4, 4).
        moment: as it is named in a problem.
        tasks: that may allow a contact, None where that is for the other side to say.
    """

    robot: ReferenceRobot | None
    part: Part
    q_a: Array
    q_b: Array
    frame: Transform
    moment: Moment
    tasks: tuple[int, ...] | None

    def moved(self) -> float:
        """Return how far the part gets at most from where it is in the middle [m]."""
        return 0.5 * float(np.abs(self.q_b - self.q_a) @ self.part.weight)

    def halves(self) -> Iterator[_Side]:
        """Yield both halves of the motion."""
        assert self.robot is not None
        middle = 0.5 * (self.q_a + self.q_b)
        for q_a, q_b in ((self.q_a, middle), (middle, self.q_b)):
            frame = self.robot.joint_frame(0.5 * (q_a + q_b), self.part.joint)
            yield self._replace(q_a=q_a, q_b=q_b, frame=frame)


def _side(body: Body, piece: int) -> _Side:
    robot, part, pieces = body.robot, body.part, body.robot.pieces
    tasks = tuple(pieces.tasks[piece].tolist())
    return _Side(
        robot.robot,
        part,
        pieces.q_a[piece],
        pieces.q_b[piece],
        robot.frames[piece, part.joint + 1],
        Moment(
            robot.name,
            int(pieces.node[piece]),
            tasks[1],
            bool(pieces.standing[piece]),
            part.entity,
        ),
        tasks,
    )


def _conflict(first: Moment, second: Moment, distance: float) -> Problem:
    how = (
        f"overlap by {-distance * 1e3:.2f} mm"
        if distance < 0
        else f"come within {distance * 1e3:.2f} mm"
    )
    kind = "hold" if first.standing or second.standing else "nodes"
    return Problem(
        "rest" if second.robot is None else kind,
        f"{first} and {second} {how}, and nothing keeps them apart",
        first,
        second,
        distance,
    )


def _without_repeats(seen: dict[_Key, Problem]) -> list[Problem]:
    """Leave out stands next to a motion that is named already: it starts or ends with them."""
    out = []
    for (u, v, u_stands, v_stands), problem in sorted(seen.items(), key=lambda p: p[0]):
        moving = [(n, v, False, v_stands) for n in (u - 1, u) if u_stands]
        moving += [(u, n, u_stands, False) for n in (v - 1, v) if v_stands]
        if not any(key in seen for key in moving):
            out.append(problem)
    return out
