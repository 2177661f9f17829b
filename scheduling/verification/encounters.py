"""Encounters in a plan: parts of two robots, or of a robot and a resting thing, close at the same time.

All proofs about simultaneous pieces obtain them here.
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
    """One side of an encounter: a robot part or its load, or a thing at rest.

    Attributes:
        motion: of the part.
        robot: whose; None for what lies.
        tasks: in which it lies there, None for all.
    """

    motion: Motion
    robot: VerifiedRobot | None
    tasks: tuple[int, ...] | None = None

    @property
    def entity(self) -> str:
        """Its name in allowed contacts."""
        return self.motion.part.entity

    def in_tasks(self, pieces: Indices, tasks: frozenset[int]) -> npt.NDArray[np.bool_]:
        """Tell in which pieces one of some tasks is executed.

        Of what lies in the world it is for the other side to say.
        """
        if self.robot is not None:
            found = np.isin(self.robot.pieces.tasks[pieces], list(tasks))
            return np.asarray(found.any(axis=1))
        there = self.tasks is None or not tasks.isdisjoint(self.tasks)
        return np.full(len(pieces), there)

    def keys(self, pieces: Indices) -> Indices:
        """Return one number for a node, and one for the stand before it; 0 for a thing at rest."""
        if self.robot is None:
            return np.zeros_like(pieces)
        return self.robot.pieces.keys[pieces]

    def moment(self, piece: int) -> Moment:
        """Return the name of a piece in a problem."""
        if self.robot is None:
            return Moment(None, -1, -1, True, self.entity)
        return self.robot.moment(piece, self.entity)

    def off_by(self, share: float) -> Side:
        """Return it with scaled errors of its motion."""
        return replace(self, motion=self.motion.off_by(share))


@dataclass(frozen=True)
class Encounter:
    """Two parts, and the pieces in which they may be close at the same time.

    Attributes:
        first, second: the parts.
        rows, columns: pieces of either, each of shape (k,).
        loaded: whether either is carried and no part of a robot.
        lies: number of what rests, None between two robots.
    """

    first: Side
    second: Side
    rows: Indices
    columns: Indices
    loaded: bool
    lies: int | None = None

    def allowed_by(
        self, depths: Depths
    ) -> Iterator[tuple[npt.NDArray[np.bool_], float]]:
        """Yield the pairs of pieces in which the two may touch, shape (k,), and the allowed depth [m]."""
        pair = frozenset((self.first.entity, self.second.entity))
        for tasks, depth in depths.get(pair, ()):
            first = self.first.in_tasks(self.rows, tasks)
            yield first & self.second.in_tasks(self.columns, tasks), depth


class Encounters:
    """All encounters of the robots of a plan, with each other and with resting things.

    Args:
        cell: its cell.
        robots: of the plan.
        still: what rests.
        precedence: what precedes what.

    Attributes:
        pairs: pairs of pieces that may be simultaneous, as far as they were looked at.
    """

    def __init__(
        self,
        cell: Workcell,
        robots: list[VerifiedRobot],
        still: StillBodies,
        precedence: Precedence,
    ) -> None:
        self._fixtures = {fixture.name for fixture in cell.fixtures}
        self.robots, self._still, self._precedence = robots, still, precedence
        self.pairs = 0

    def all_within(
        self, between: float, from_rest: float
    ) -> Iterator[Iterator[Encounter]]:
        """Yield the encounters of every two robots, then of every robot and resting things.

        Args:
            between: distance up to which two robots are near each other [m].
            from_rest: likewise a robot and what rests [m].
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
        for close in close_pairs(still.sweeps, robot.sweeps, windows, limits):
            groups = _groups(close, close.i, robot.which(close.y, close.j))
            for (_, lies, y, m), _, pieces in groups:
                rest, motion = still.resting[lies], robot.bodies[y].motions[m]
                if motion.part.joint < 0 and rest.object in self._fixtures:
                    continue
                first = Side(motion, robot)
                second = Side(still.motions[lies], None, rest.tasks)
                if rest.hand == robot.name:  # its own: it errs as the robot does
                    first, second = first.off_by(0.0), second.off_by(0.0)
                yield Encounter(
                    first,
                    second,
                    pieces,
                    np.zeros_like(pieces),
                    True,
                    lies,
                )


def _groups(
    close: Close, which_x: Indices, which_y: Indices
) -> Iterator[tuple[tuple[int, int, int, int], Indices, Indices]]:
    """Yield body and motion of both sides, and the pieces in which they come close."""
    kinds = np.stack([close.x, which_x, close.y, which_y])
    order = np.lexsort(kinds)
    changes = np.any(np.diff(kinds[:, order], axis=1) != 0, axis=0)
    for chosen in np.split(order, np.flatnonzero(changes) + 1):
        x, k, y, m = kinds[:, chosen[0]].tolist()
        yield (x, k, y, m), close.i[chosen], close.j[chosen]
