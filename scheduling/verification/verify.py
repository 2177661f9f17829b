"""Independent, slow proof that a saved plan keeps its guarantee (``twin verify``).

Nothing here is shared with the code that builds the graph: order comes from sets of ancestors,
geometry from pinocchio's own reading of the URDF files and coal's exact shapes, occupancy from
dense samples grown by the motion between them; no capsules, no clocks, no conflict search.
Checked are the structure; that what is done is what tasks say, and that no robot and no object jumps;
and the invariant: (a) nodes of two robots that come too close are ordered, (b) so are a node and a robot
that stands, (c) and a node and an object at rest. What may touch is held to a depth.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt

from planning.progress import Progress, no_progress
from planning.transforms import Indices, Transform
from scheduling.graph.temporal_plan_graph import TemporalPlanGraph
from scheduling.verification.bodies import (
    Motion,
    StillBodies,
    VerifiedRobot,
    at_once,
    while_there,
)
from scheduling.verification.fulfilment import not_as_said
from scheduling.verification.graph_structure import Precedence, check_structure
from scheduling.verification.measuring import Measuring
from scheduling.verification.object_places import (
    Carried,
    Resting,
    jumps,
    object_histories,
)
from scheduling.verification.problems import Moment, Problem
from scheduling.verification.reference import TOLERANCE, ReferenceRobot
from scheduling.verification.sweeps import Close, close_pairs
from scheduling.verification.touching import (
    allowed_depths,
    too_deep_in_hand,
    touching_itself,
)

__all__ = ["Moment", "Problem", "VerificationReport", "verify_plan"]


_Key = tuple[int, int]
"""Of both sides: 2 * node, and one more where the robot stands before it."""


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
    progress: Progress = no_progress,
) -> VerificationReport:
    """Check a plan from scratch.

    Args:
        tpg: the plan.
        limit: stop after so many problems.
        progress: told how far it has come.
    """
    precedence, problems = check_structure(tpg)
    geometry = {robot.name: ReferenceRobot(robot) for robot in tpg.cell.robots}
    speeds = {name: robot.speeds for name, robot in geometry.items()}
    problems += not_as_said(tpg, speeds)

    def flange(chain: int, node: int, waypoint: int) -> Transform:
        c = tpg.chains[chain]
        before = int(c.first[node]) + waypoint - 1
        q = c.start if before < 0 else c.waypoints[before]
        return geometry[c.robot].flange_pose(q)

    problems += jumps(tpg, flange)
    check = _ClearanceCheck(tpg, limit - len(problems), progress)
    if precedence is not None and len(problems) < limit:
        check.run(precedence, geometry, object_histories(tpg, flange))
    return VerificationReport(
        check.pairs,
        check.robots.least,
        check.objects.least,
        tuple([*problems, *check.problems][:limit]),
    )


class _ClearanceCheck:
    """Looks at all pairs of pieces that may happen at once.

    Args:
        tpg: the plan.
        limit: stop after so many problems.
        progress: told how far it has come.

    Attributes:
        problems: found so far.
        pairs: pairs of pieces looked at.
        robots, objects, contacts: measure between two robots, between other things, and where
            these may touch.
    """

    def __init__(self, tpg: TemporalPlanGraph, limit: int, progress: Progress) -> None:
        self.tpg, self.limit, self.progress = tpg, limit, progress
        self.problems: list[Problem] = []
        self.pairs = 0
        self.robots, self.objects = Measuring(), Measuring()
        self.contacts = Measuring()
        self.allowed = allowed_depths(tpg)

    def run(
        self,
        precedence: Precedence,
        geometry: Mapping[str, ReferenceRobot],
        histories: tuple[list[Carried], list[Resting]],
    ) -> None:
        """Check all pairs of robots, then every robot against what rests in the world.

        Args:
            precedence: what precedes what.
            geometry: of all robots.
            histories: of all objects.
        """
        tpg, cell = self.tpg, self.tpg.cell
        carried, resting = histories
        self.problems += too_deep_in_hand(tpg, geometry, carried, self.allowed)
        robots = [
            VerifiedRobot(tpg, placed, geometry[placed.name], carried)
            for placed in cell.robots
        ]
        still = StillBodies(resting)
        pairs = list(combinations(robots, 2))
        total = len(pairs) + len(robots)
        for done, (a, b) in enumerate(pairs, 1):
            self._robots(a, b, precedence)
            self.progress(done, total)
        for done, robot in enumerate(robots, len(pairs) + 1):
            self._rest(robot, still, precedence)
            self.problems += touching_itself(robot, geometry[robot.name])
            self.progress(done, total)

    def _robots(
        self, a: VerifiedRobot, b: VerifiedRobot, precedence: Precedence
    ) -> None:
        windows = at_once(a, b, precedence)
        self.pairs += int((windows[1] - windows[0]).sum())
        clearances = self.tpg.cell.clearances
        loaded = np.array(
            [[x.load or y.load for y in b.bodies] for x in a.bodies], dtype=np.bool_
        )
        limits = np.full(loaded.shape, clearances.robot_robot)
        seen: dict[_Key, Problem] = {}
        for close in close_pairs(a.sweeps, b.sweeps, windows, limits):
            which = a.which(close.x, close.i), b.which(close.y, close.j)
            for (x, k, y, m), rows, columns in _groups(close, *which):
                if len(self.problems) + len(seen) >= self.limit:
                    break
                sides = (
                    _Side(a.bodies[x].motions[k], a),
                    _Side(b.bodies[y].motions[m], b),
                )
                kind = self.objects if loaded[x, y] else self.robots
                self._settle(sides, (rows, columns), limits[x, y], kind, seen)
        self.problems += _without_repeats(seen)

    def _rest(
        self, robot: VerifiedRobot, still: StillBodies, precedence: Precedence
    ) -> None:
        windows = while_there(robot, still.resting, precedence)
        self.pairs += int((windows[1] - windows[0]).sum())
        limit = self.tpg.cell.clearances.robot_object
        fixtures = {f.name for f in self.tpg.cell.fixtures}
        limits = np.full((1, len(robot.bodies)), limit)
        seen: dict[int, dict[_Key, Problem]] = {}
        for close in close_pairs(still.sweeps, robot.sweeps, windows, limits):
            groups = _groups(close, close.i, robot.which(close.y, close.j))
            for (_, lies, y, m), _, pieces in groups:
                if len(self.problems) + sum(map(len, seen.values())) >= self.limit:
                    break
                rest, motion = still.resting[lies], robot.bodies[y].motions[m]
                if motion.part.joint < 0 and rest.object in fixtures:
                    continue
                self._settle(
                    (
                        _Side(motion, robot),
                        _Side(still.motions[lies], None, rest.tasks),
                    ),
                    (pieces, np.zeros_like(pieces)),
                    limit,
                    self.objects,
                    seen.setdefault(lies, {}),
                )
        for lies in sorted(seen):
            self.problems += _without_repeats(seen[lies])

    def _settle(
        self,
        sides: tuple[_Side, _Side],
        pairs: tuple[Indices, Indices],
        limit: float,
        measuring: Measuring,
        seen: dict[_Key, Problem],
    ) -> None:
        """Note what comes too close in some pairs of pieces, or too deep where it may touch."""
        a, b = sides
        entities = a.motion.part.entity, b.motion.part.entity
        if entities[0] == entities[1]:
            return
        least = np.full(len(pairs[0]), limit)
        for tasks, depth in self.allowed.get(frozenset(entities), ()):
            now = a.in_tasks(pairs[0], tasks) & b.in_tasks(pairs[1], tasks)
            least[now] = np.minimum(least[now], -depth)
        keys = np.stack([a.keys(pairs[0]), b.keys(pairs[1])])
        if seen:
            new = [key not in seen for key in zip(*keys.tolist(), strict=True)]
            least[~np.array(new)] = -np.inf
        for bound in np.unique(least[least > -np.inf]).tolist():
            some, how = least == bound, measuring if bound == limit else self.contacts
            rows, columns = pairs[0][some], pairs[1][some]
            known = keys[:, some]
            alike = np.ravel_multi_index(tuple(known), tuple(known.max(axis=1) + 1))
            for k, distance in how.too_close(
                a.motion, b.motion, (rows, columns), bound - TOLERANCE, alike
            ):
                first, second = a.moment(int(rows[k])), b.moment(int(columns[k]))
                seen[known[0, k], known[1, k]] = _conflict(first, second, distance)


@dataclass(frozen=True)
class _Side:
    """A part of a robot or what it carries; or what lies in the world, or in a hand that stands.

    Attributes:
        motion: of the part.
        robot: whose; None for what lies.
        tasks: in which it lies there, None for all.
    """

    motion: Motion
    robot: VerifiedRobot | None
    tasks: tuple[int, ...] | None = None

    def in_tasks(self, pieces: Indices, tasks: frozenset[int]) -> npt.NDArray[np.bool_]:
        """Tell in which pieces one of some tasks is done.

        Of what lies in the world it is for the other side to say.
        """
        if self.robot is not None:
            found = np.isin(self.robot.pieces.tasks[pieces], list(tasks))
            return np.asarray(found.any(axis=1))
        there = self.tasks is None or not tasks.isdisjoint(self.tasks)
        return np.full(len(pieces), there)

    def keys(self, pieces: Indices) -> Indices:
        """Return one number for a node, and one for the stand before it; 0 for what lies."""
        if self.robot is None:
            return np.zeros_like(pieces)
        return self.robot.pieces.keys[pieces]

    def moment(self, piece: int) -> Moment:
        """Return a piece as it is named in a problem."""
        entity = self.motion.part.entity
        if self.robot is None:
            return Moment(None, -1, -1, True, entity)
        return self.robot.moment(piece, entity)


def _groups(
    close: Close, which_x: Indices, which_y: Indices
) -> Iterator[tuple[tuple[int, int, int, int], Indices, Indices]]:
    """Yield body and motion of both sides, and the pieces in which these two come close."""
    kinds = np.stack([close.x, which_x, close.y, which_y])
    order = np.lexsort(kinds)
    changes = np.any(np.diff(kinds[:, order], axis=1) != 0, axis=0)
    for chosen in np.split(order, np.flatnonzero(changes) + 1):
        x, k, y, m = kinds[:, chosen[0]].tolist()
        yield (x, k, y, m), close.i[chosen], close.j[chosen]


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
    for (u, v), problem in sorted(seen.items(), key=lambda p: p[0]):
        moving = [(n, v) for n in (u - 3, u - 1) if u % 2]
        moving += [(u, n) for n in (v - 3, v - 1) if v % 2]
        if not any(key in seen for key in moving):
            out.append(problem)
    return out
