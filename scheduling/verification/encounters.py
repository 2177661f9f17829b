"""Encounters in a plan: two bodies that may come close to each other.

One belongs to a robot or its load. The other belongs to another robot, or to an object or fixture at rest. A
*piece* is a short motion of a robot, or its standstill between two nodes. An encounter lists the pairs of pieces
that may be simultaneous and in which the two bodies come close. ``verify`` and ``survived_errors`` measure
distances in these pairs only.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import numpy.typing as npt

from planning.cell.workcell import Workcell
from planning.transforms import Array, Indices
from scheduling.verification.bodies import (
    StillBodies,
    VerifiedRobot,
    pieces_during,
    simultaneous_pieces,
)
from scheduling.verification.graph_structure import Precedence
from scheduling.verification.problems import Moment
from scheduling.verification.touching import Depths
from scheduling.witness.motion import Motion
from scheduling.witness.sweeps import Close, close_pairs


@dataclass(frozen=True)
class Side:
    """One side of an encounter: a part of a robot, its load, or an object or fixture at rest.

    Attributes:
        motion: motion of the part.
        robot: robot that moves it; None at rest.
        tasks: tasks during which an object is at rest there, None for all.
    """

    motion: Motion
    robot: VerifiedRobot | None
    tasks: tuple[int, ...] | None = None

    @property
    def entity(self) -> str:
        """Name of the part in allowed contacts."""
        return self.motion.part.entity

    def in_tasks(self, pieces: Indices, tasks: frozenset[int]) -> npt.NDArray[np.bool_]:
        """Tell in which pieces one of some tasks may be executed.

        An object at rest has no task of its own: True in all pieces, unless ``self.tasks`` has none of the tasks.
        """
        if self.robot is not None:
            found = np.isin(self.robot.pieces.tasks[pieces], list(tasks))
            return np.asarray(found.any(axis=1))
        there = self.tasks is None or not tasks.isdisjoint(self.tasks)
        return np.full(len(pieces), there)

    def keys(self, pieces: Indices) -> Indices:
        """Return a number for each piece: one per node, one per standstill before a node; 0 at rest."""
        if self.robot is None:
            return np.zeros_like(pieces)
        return self.robot.pieces.keys[pieces]

    def moment(self, piece: int) -> Moment:
        """Return the description of a piece in a problem."""
        if self.robot is None:
            return Moment(None, -1, -1, True, self.entity)
        return self.robot.moment(piece, self.entity)

    def with_errors_scaled(self, share: float) -> Side:
        """Return the side with scaled errors of its motion."""
        return replace(self, motion=self.motion.with_errors_scaled(share))


@dataclass(frozen=True)
class Encounter:
    """Two parts, and the pieces in which they may be close at the same time.

    Attributes:
        first: a part of a robot, or what it carries.
        second: likewise of another robot, or an object or fixture at rest.
        rows, columns: pieces of either, each of shape (k,).
        loaded: whether either is an object or fixture, not a part of a robot.
        at_rest: index of the part at rest, None between two robots.
    """

    first: Side
    second: Side
    rows: Indices
    columns: Indices
    loaded: bool
    at_rest: int | None = None

    def allowed_by(self, depths: Depths) -> Iterator[tuple[Indices, float]]:
        """Yield the indices of pairs of pieces that allow a contact, and its allowed depth [m]."""
        contacts = depths.get(frozenset((self.first.entity, self.second.entity)), ())
        if not contacts:
            return
        assert self.first.robot is not None
        own = self.first.robot.pieces.tasks[self.rows]
        order = np.argsort(own, axis=None, kind="stable")
        task, first = np.unique(own.ravel()[order], return_index=True)
        parts = np.split(order // own.shape[1], first[1:])
        rows_of = dict(zip(task.tolist(), parts, strict=True))
        for tasks, depth in contacts:
            some = [rows_of[t] for t in tasks if t in rows_of]
            if some:
                rows = np.unique(np.concatenate(some))
                yield rows[self.second.in_tasks(self.columns[rows], tasks)], depth


class Encounters:
    """All encounters of the robots of a plan, with each other and with objects and fixtures at rest.

    Args:
        cell: cell of the plan.
        robots: robots of the plan.
        still: objects and fixtures at rest.
        precedence: precedence of the nodes.

    Attributes:
        pairs: number of pairs of pieces so far that may be simultaneous.
    """

    def __init__(
        self,
        cell: Workcell,
        robots: list[VerifiedRobot],
        still: StillBodies,
        precedence: Precedence,
    ) -> None:
        self._cell = cell
        self._fixtures = {fixture.name for fixture in cell.fixtures}
        self.robots, self._still, self._precedence = robots, still, precedence
        self.pairs = 0

    def all_within(
        self, between: float, from_rest: float
    ) -> Iterator[Iterator[Encounter]]:
        """Yield the encounters of every two robots, then of every robot with objects and fixtures at rest.

        Args:
            between: distance up to which two robots are near each other [m].
            from_rest: distance up to which a robot and an object or fixture are near each other [m].
        """
        for a, b in combinations(self.robots, 2):
            yield self._of_robots(a, b, between)
        for robot in self.robots:
            yield self._at_rest(robot, from_rest)

    @property
    def count(self) -> int:
        """Number of times that ``all_within`` yields."""
        robots = len(self.robots)
        return robots * (robots - 1) // 2 + robots

    def _of_robots(
        self, a: VerifiedRobot, b: VerifiedRobot, limit: float
    ) -> Iterator[Encounter]:
        windows = simultaneous_pieces(a, b, self._precedence)
        self.pairs += int((windows[1] - windows[0]).sum())
        limits = np.full((len(a.bodies), len(b.bodies)), limit)
        for close in close_pairs(a.sweeps, b.sweeps, windows, limits):
            which = a.which(close.x, close.i), b.which(close.y, close.j)
            for (x, k, y, m), rows, columns in _groups(close, *which):
                first, second = a.bodies[x], b.bodies[y]
                yield Encounter(
                    Side(first.motions[k], a),
                    Side(second.motions[m], b),
                    rows,
                    columns,
                    first.load or second.load,
                )

    def _at_rest(self, robot: VerifiedRobot, limit: float) -> Iterator[Encounter]:
        still = self._still
        windows = pieces_during(robot, still.resting, self._precedence)
        self.pairs += int((windows[1] - windows[0]).sum())
        limits: Array = np.full((1, len(robot.bodies)), limit)
        mounted = {item.name for item in self._cell.robot(robot.name).mounted_on}
        for close in close_pairs(still.sweeps, robot.sweeps, windows, limits):
            groups = _groups(close, close.i, robot.which(close.y, close.j))
            for (_, k, y, m), _, pieces in groups:
                rest, motion = still.resting[k], robot.bodies[y].motions[m]
                if motion.part.joint < 0 and rest.object in self._fixtures:
                    continue
                bolted = rest.object in mounted and not robot.bodies[y].load
                if bolted and robot.touches_at_home(motion.part, still.motions[k]):
                    continue
                first = Side(motion, robot)
                second = Side(still.motions[k], None, rest.tasks)
                # The object is displaced together with the robot.
                if rest.hand == robot.name or rest.object in mounted:
                    first, second = (
                        first.with_errors_scaled(0.0),
                        second.with_errors_scaled(0.0),
                    )
                yield Encounter(
                    first,
                    second,
                    pieces,
                    np.zeros_like(pieces),
                    True,
                    k,
                )


def _groups(
    close: Close, which_x: Indices, which_y: Indices
) -> Iterator[tuple[tuple[int, int, int, int], Indices, Indices]]:
    """Yield indices of body and motion of both sides, and the pieces in which they come close."""
    kinds = np.stack([close.x, which_x, close.y, which_y])
    order = np.lexsort(kinds)
    changes = np.any(np.diff(kinds[:, order], axis=1) != 0, axis=0)
    for chosen in np.split(order, np.flatnonzero(changes) + 1):
        x, k, y, m = kinds[:, chosen[0]].tolist()
        yield (x, k, y, m), close.i[chosen], close.j[chosen]
