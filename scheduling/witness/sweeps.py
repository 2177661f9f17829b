"""Bounds of swept volumes along fixed directions, and a search for pairs of motion pieces that come close."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
import numpy.typing as npt

from planning.transforms import Array, Indices

DIRECTIONS = np.array(
    [d for d in product((-1.0, 0.0, 1.0), repeat=3) if d > (0.0, 0.0, 0.0)]
)
"""Axes, then diagonals, one of each opposite pair, of unit length, shape (13, 3)."""
DIRECTIONS /= np.linalg.norm(DIRECTIONS, axis=1)[:, None]
DIRECTIONS = DIRECTIONS[np.argsort(-np.abs(DIRECTIONS).max(axis=1), kind="stable")]


_GROUP = 4
"""Pieces, or groups of them, that make a group of the next level."""
_LEVELS = 3
"""Levels of groups above the pieces."""

_AT_ONCE = 1 << 19
"""Pairs that are looked at in one go."""


@dataclass(frozen=True)
class SweepBounds:
    """Bounds of bodies along DIRECTIONS in each piece, and in groups of consecutive pieces.

    Attributes:
        low, high: per level; level 0 has one group for each piece. Where a body is not there
            low is infinite and high is minus infinity, each of shape (13, groups, bodies) [m].
    """

    low: tuple[Array, ...]
    high: tuple[Array, ...]

    @staticmethod
    def nothing(pieces: int, bodies: int) -> SweepBounds:
        """Return empty sweeps of bodies, one level, to be filled in."""
        shape = (len(DIRECTIONS), pieces, bodies)
        return SweepBounds((np.full(shape, np.inf),), (np.full(shape, -np.inf),))

    def with_coarser(self) -> SweepBounds:
        """Return the sweeps with all levels above the first."""
        low, high = list(self.low), list(self.high)
        for _ in range(_LEVELS):
            starts = np.arange(0, low[-1].shape[1], _GROUP)
            low.append(np.minimum.reduceat(low[-1], starts, axis=1))
            high.append(np.maximum.reduceat(high[-1], starts, axis=1))
        return SweepBounds(tuple(low), tuple(high))

    @property
    def top(self) -> int:
        """The coarsest level."""
        return len(self.low) - 1


@dataclass(frozen=True)
class Close:
    """Pairs of bodies in pieces whose bounds come close.

    Attributes:
        x, y: indices of bodies, shape (k,).
        i, j: indices of pieces, shape (k,).
    """

    x: Indices
    y: Indices
    i: Indices
    j: Indices

    def __len__(self) -> int:
        """Return the number of pairs."""
        return len(self.x)

    def of(self, chosen: Indices | npt.NDArray[np.bool_]) -> Close:
        """Return some of the pairs."""
        return Close(self.x[chosen], self.y[chosen], self.i[chosen], self.j[chosen])

    def by_bodies(self) -> Iterator[tuple[int, int, Indices]]:
        """Yield every two bodies, and which of the pairs are theirs, in the order of the pieces."""
        order = np.lexsort((self.j, self.i, self.y, self.x))
        changes = np.diff(self.x[order]) | np.diff(self.y[order])
        for chosen in np.split(order, np.flatnonzero(changes) + 1):
            yield int(self.x[chosen[0]]), int(self.y[chosen[0]]), chosen


def close_pairs(
    a: SweepBounds, b: SweepBounds, windows: tuple[Indices, Indices], limits: Array
) -> Iterator[Close]:
    """Yield all pairs that may come closer than a limit.

    Args:
        a, b: the two.
        windows: pieces of ``b`` that may happen together with each of ``a``: from the first
            number on up to the second.
        limits: for bodies of both, shape (bodies of a, bodies of b) [m].
    """
    lows, highs = [windows[0]], [windows[1]]
    for _ in range(a.top):
        starts = np.arange(0, len(lows[-1]), _GROUP)
        lows.append(np.minimum.reduceat(lows[-1], starts))
        highs.append(np.maximum.reduceat(highs[-1], starts))
    i, j = _within(lows[-1], highs[-1], _GROUP**b.top)
    whole = _whole(a), _whole(b)
    most = np.full(len(i), float(limits.max()))
    chosen = _close(whole[0], whole[1], i, j, most)
    i, j = i[chosen], j[chosen]
    counts = limits.shape
    step = max(1, _AT_ONCE // limits.size)
    for k in range(0, len(i), step):
        here, there = i[k : k + step], j[k : k + step]
        pairs = Close(
            np.tile(np.repeat(np.arange(counts[0]), counts[1]), len(here)),
            np.tile(np.arange(counts[1]), counts[0] * len(here)),
            np.repeat(here, limits.size),
            np.repeat(there, limits.size),
        )
        yield from _descend(a, b, (lows, highs), limits, pairs, (a.top, b.top))


def gaps_of(a: SweepBounds, b: SweepBounds, close: Close) -> Array:
    """Return lower bounds of the distances of pairs of bodies in their pieces, shape (k,) [m]."""
    low_a, high_a = (side[0][:, close.i, close.x] for side in (a.low, a.high))
    low_b, high_b = (side[0][:, close.j, close.y] for side in (b.low, b.high))
    return np.asarray(np.maximum(low_a - high_b, low_b - high_a).max(axis=0))


def _descend(
    a: SweepBounds,
    b: SweepBounds,
    windows: tuple[list[Indices], list[Indices]],
    limits: Array,
    pairs: Close,
    levels: tuple[int, int],
) -> Iterator[Close]:
    """Yield the close pairs of pieces within pairs of groups."""
    of_a, of_b = levels
    size = _GROUP**of_b
    inside = (windows[0][of_a][pairs.i] < (pairs.j + 1) * size) & (
        windows[1][of_a][pairs.i] > pairs.j * size
    )
    pairs = pairs.of(inside)
    chosen = _close(
        (a.low[of_a], a.high[of_a]),
        (b.low[of_b], b.high[of_b]),
        pairs.i * limits.shape[0] + pairs.x,
        pairs.j * limits.shape[1] + pairs.y,
        limits[pairs.x, pairs.y],
    )
    pairs = pairs.of(chosen)
    if not len(pairs):
        return
    if levels == (0, 0):
        yield pairs
        return
    step = _AT_ONCE // _GROUP**2
    for k in range(0, len(pairs), step):
        some = pairs.of(np.arange(k, min(k + step, len(pairs))))
        yield from _descend(
            a,
            b,
            windows,
            limits,
            _finer(some, levels, (a.low, b.low)),
            (max(of_a - 1, 0), max(of_b - 1, 0)),
        )


def _finer(
    pairs: Close,
    levels: tuple[int, int],
    bounds: tuple[tuple[Array, ...], tuple[Array, ...]],
) -> Close:
    """Return all pairs of groups of the level below."""
    for side, level in enumerate(levels):
        if level == 0:
            continue
        group = pairs.j if side else pairs.i
        parts = (group[:, None] * _GROUP + np.arange(_GROUP)).reshape(-1)
        index = np.repeat(np.arange(len(group)), _GROUP)
        there = parts < bounds[side][level - 1].shape[1]
        parts, rest = parts[there], pairs.of(index[there])
        i, j = (rest.i, parts) if side else (parts, rest.j)
        pairs = Close(rest.x, rest.y, i, j)
    return pairs


def _whole(sweeps: SweepBounds) -> tuple[Array, Array]:
    """Return bounds around all bodies at the coarsest level."""
    low, high = sweeps.low[-1].min(axis=2), sweeps.high[-1].max(axis=2)
    return low[:, :, None], high[:, :, None]


def _close(
    a: tuple[Array, Array],
    b: tuple[Array, Array],
    rows: Indices,
    columns: Indices,
    limits: Array,
) -> Indices:
    """Return the pairs that no direction separates by more than their limits."""
    low_a, high_a, low_b, high_b = (
        bounds.reshape(len(DIRECTIONS), -1) for bounds in (*a, *b)
    )
    left = np.arange(len(rows))
    for d in range(len(DIRECTIONS)):
        u, v = rows[left], columns[left]
        gap = np.maximum(low_a[d][u] - high_b[d][v], low_b[d][v] - high_a[d][u])
        left = left[gap < limits[left]]
        if not len(left):
            break
    return left


def _within(low: Indices, high: Indices, size: int) -> tuple[Indices, Indices]:
    """Return pairs of a group of one side and a group of the other that its window overlaps."""
    first, count = low // size, np.where(high > low, (high - 1) // size + 1, 0)
    count = np.maximum(count - np.where(high > low, first, 0), 0)
    i = np.repeat(np.arange(len(low)), count)
    j = np.arange(len(i)) - np.repeat(np.cumsum(count) - count, count) + first[i]
    return i, j
