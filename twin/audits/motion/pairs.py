"""Pairs of collision shapes that may come close to each other during an interval of a run.

For each pair, the module lists the motion segments during which the two shapes may be close.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import numpy.typing as npt

from planning.transforms import Array, Indices
from scheduling.witness.motion import Motion
from scheduling.witness.own_motions import OwnMotions
from scheduling.witness.parts import measure
from scheduling.witness.sweeps import Close, close_pairs, gaps_of
from twin.audits.motion.stretches import RunStretch
from twin.audits.worlds.world import WatchedShape

SLACK = 1e-4
"""Overlaps up to this are numerical: 2.5 times the measured error of Bullet's distances [m]."""


@dataclass(frozen=True)
class ClosePair:
    """Two shapes, and the segments of their motions in which they may come close to each other.

    Attributes:
        a, b: the shapes.
        x, y: their motions.
        rows, columns: pieces of either that are at the same time, shape (k,).
        first, last: samples with which that time begins and ends, shape (k,).
        gaps: lower bounds of their distances in these pieces, 0 unless they are of two robots,
            shape (k,) [m].
        two_robots: whether they are of two robots, or of what two robots carry.
    """

    a: WatchedShape
    b: WatchedShape
    x: Motion
    y: Motion
    rows: Indices
    columns: Indices
    first: Indices
    last: Indices
    gaps: Array
    two_robots: bool = False

    def __len__(self) -> int:
        """Return the number of pairs of pieces."""
        return len(self.rows)

    @property
    def pieces(self) -> tuple[Indices, Indices]:
        """The pieces of either shape."""
        return self.rows, self.columns

    @property
    def entities(self) -> frozenset[str]:
        """Names of both in allowed contacts."""
        return frozenset((self.a.entity, self.b.entity))

    def middle_gap(self, pair: int) -> float:
        """Return the distance in the middle of a pair of pieces [m]."""
        x, y = self.x.frame(int(self.rows[pair])), self.y.frame(int(self.columns[pair]))
        return measure(self.x.part, x, self.y.part, y)

    def gaps_at_ends(self, pair: int) -> tuple[float, float]:
        """Return the distances with which the time of a pair of pieces begins and ends [m]."""
        row, column = int(self.rows[pair]), int(self.columns[pair])
        begin, end = (
            measure(
                self.x.part,
                self.x.frames[row + k],
                self.y.part,
                self.y.frames[column + k],
            )
            for k in (0, 1)
        )
        return begin, end

    def some(self, chosen: Indices | npt.NDArray[np.bool_]) -> ClosePair:
        """Return it with some of the pairs of pieces."""
        parts = {
            name: getattr(self, name)[chosen]
            for name in ("rows", "columns", "first", "last", "gaps")
        }
        return replace(self, **parts)


def pairs_of_robots(
    stretch: RunStretch, robots: tuple[int, int], limit: float
) -> Iterator[ClosePair]:
    """Yield pairs of shapes of two robots, and of what they hold.

    Args:
        stretch: the piece of the run.
        robots: numbers of the robots.
        limit: pairs that stay further apart are left out [m].
    """
    one, other = (stretch.robots[k] for k in robots)
    limits = np.full((len(one.parts), len(other.parts)), limit)
    windows = one.simultaneous(other)
    found = []
    for close in close_pairs(one.sweeps, other.sweeps, windows, limits):
        gaps = gaps_of(one.sweeps, other.sweeps, close)
        for i, j, which in close.by_bodies():
            rows, columns = close.i[which], close.j[which]
            first = np.maximum(one.begin[rows], other.begin[columns])
            last = np.minimum(one.end[rows], other.end[columns])
            sides = [
                (stretch.shapes[robots[0]][i], one.motions[i], rows),
                (stretch.shapes[robots[1]][j], other.motions[j], columns),
            ]
            # Robots come before what they hold.
            (a, x, of_a), (b, y, of_b) = sorted(sides, key=lambda side: side[0].number)
            pair = ClosePair(a, b, x, y, of_a, of_b, first, last, gaps[which], True)
            found.append(pair)
    yield from sorted(found, key=lambda pair: float(pair.gaps.min()))


def pairs_of_robot(
    stretch: RunStretch, robot: int, exempt: Collection[tuple[int, int]]
) -> Iterator[ClosePair]:
    """Yield pairs of shapes of one robot and what it holds that may overlap, seen from the inner one.

    Args:
        stretch: the piece of the run.
        robot: number of the robot.
        exempt: pairs of one robot's shapes that are not checked, see ``overlapping_at_home``.
    """
    moving, shapes = stretch.robots[robot], stretch.shapes[robot]
    limits = np.full((len(shapes), len(shapes)), -np.inf)
    for (i, a), (j, b) in combinations(enumerate(shapes), 2):
        same = a.robot is None and a.entity == b.entity  # shapes of one load
        if not same and (a.number, b.number) not in exempt:
            limits[i, j] = 0.0
    own = OwnMotions(moving.robot, moving.knots, moving.frames)
    windows = moving.pieces, moving.pieces + 1
    for close in close_pairs(moving.sweeps, moving.sweeps, windows, limits):
        for i, j, which in close.by_bodies():
            pieces = close.i[which]
            inner, outer = moving.parts[i], moving.parts[j]
            if inner.joint > outer.joint:
                inner, outer = outer, inner
            still, moves = own.seen(inner, outer)
            one = np.zeros_like(pieces)
            first, last = moving.begin[pieces], moving.end[pieces]
            gaps = np.zeros(len(pieces))
            yield ClosePair(
                shapes[i], shapes[j], still, moves, one, pieces, first, last, gaps
            )


def pairs_at_rest(
    stretch: RunStretch, robot: int, exempt: Collection[tuple[int, int]]
) -> Iterator[ClosePair]:
    """Yield pairs of a shape of a robot, or of what it holds, and one at rest that may overlap.

    Args:
        stretch: the piece of the run.
        robot: number of the robot.
        exempt: pairs of a robot's shape and one at rest that are not checked, see ``overlapping_at_home``.
    """
    moving, still = stretch.robots[robot], stretch.still
    count = len(still.motions)
    windows = np.zeros(count, dtype=np.int64), np.full(count, len(moving.begin))
    limits = np.zeros((1, len(moving.parts)))
    limits[
        0, [part.joint < 0 for part in moving.parts]
    ] = -np.inf  # bases stand on tables
    for close in close_pairs(still.sweeps, moving.sweeps, windows, limits):
        close = Close(close.y, close.i, close.j, close.x)
        for i, j, which in close.by_bodies():
            pieces = close.i[which]
            mine, other = stretch.shapes[robot][i], stretch.resting[j][0]
            if (mine.number, other.number) in exempt:
                continue
            yield ClosePair(
                mine,
                other,
                moving.motions[i],
                still.motions[j],
                pieces,
                np.zeros_like(pieces),
                moving.begin[pieces],
                moving.end[pieces],
                np.zeros(len(pieces)),
            )
