"""Collision checks of two moving robots for all combinations of positions on their motions, in compiled code."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planning.cell.workcell import Workcell, WorldState
from planning.geometry.distance import are_boxes_apart, segment_segment
from planning.geometry.hull_table import HullTable
from planning.geometry.robot_bodies import (
    cell_entities,
    limits_of_entities,
    objects_held_by,
    robot_bodies,
)
from planning.geometry.separation import (
    APART,
    Scratch,
    check_hulls_continuously,
    make_scratch,
    pose_segments,
)
from planning.geometry.swept import (
    Sweeps,
    SweptBodies,
    make_swept,
    set_stretch,
    sweep_bodies,
)
from planning.kernels import ZERO, inner_kernel, kernel
from planning.packed import packed
from planning.transforms import Array, Indices

SweptPiece = tuple[HullTable, Sweeps, int, Indices]
"""Bodies of a robot, swept volumes of its motion, index of the piece of motion, and entity of each body."""

_HALVINGS = 5
"""How often a part is halved before the robots are called too close."""


@inner_kernel
def are_pieces_apart(
    a: SweptPiece,
    b: SweptPiece,
    limits: Array,
    widest: float,
    pairs: Indices,
    scratch: Scratch,
) -> bool:
    """Tell whether bodies are proved to keep their clearances, each anywhere on its piece.

    Args:
        a, b: the bodies.
        limits: least distances of entities, SKIP for none, shape (e, e) [m].
        widest: the greatest of them [m].
        pairs: work array for pairs of bodies.
        scratch: work array.
    """
    count = write_near_pairs(a, b, limits, widest, pairs)
    if count == 0:
        return True
    return are_pairs_apart(pairs, count, (a[0], a[3]), (b[0], b[3]), limits, scratch)


@inner_kernel
def write_near_pairs(
    a: SweptPiece, b: SweptPiece, limits: Array, widest: float, out: Indices
) -> int:
    """Write the pairs of bodies whose capsules come nearer than their limits.

    Args:
        a, b, limits, widest: see ``are_pieces_apart``.
        out: receives for each pair the number of the one body times that of the other bodies,
            plus the number of one of these.

    Returns:
        How many there are.
    """
    a_hulls, a_swept, i, rows = a
    b_hulls, b_swept, j, columns = b
    x, c = a_swept.body_first[i], a_swept.capsule_first[i]
    y, d = b_swept.body_first[j], b_swept.capsule_first[j]
    a_box, b_box, around = a_swept.body_box, b_swept.body_box, a_swept.box
    a_joint, a_first = a_hulls.joint, a_hulls.capsule_first
    b_joint, b_first = b_hulls.joint, b_hulls.capsule_first
    count = ZERO
    for p in range(len(b_joint)):
        if are_boxes_apart(around, i, b_box, y + p, widest):
            continue
        d0, d1 = d + b_first[p], d + b_first[p + 1]
        for o in range(len(a_joint)):
            limit = limits[rows[o], columns[p]]
            if (
                limit >= 0.0
                and not are_boxes_apart(a_box, x + o, b_box, y + p, limit)
                and (a_joint[o] >= 0 or b_joint[p] >= 0)
            ):
                c0, c1 = c + a_first[o], c + a_first[o + 1]
                if _capsules_meet(a_swept, c0, c1, b_swept, d0, d1, limit):
                    out[count] = o * len(b_joint) + p
                    count += 1
    return count


@inner_kernel
def _capsules_meet(
    a: Sweeps, first: int, last: int, b: Sweeps, low: int, high: int, limit: float
) -> bool:
    """Tell whether capsules ``range(first, last)`` come within a limit of ``range(low, high)``."""
    a_start, a_end, a_radius = a.capsule_a, a.capsule_b, a.radius
    b_start, b_end, b_radius = b.capsule_a, b.capsule_b, b.radius
    for c in range(first, last):
        for d in range(low, high):
            reach = a_radius[c] + b_radius[d] + limit
            gap = segment_segment(a_start[c], a_end[c], b_start[d], b_end[d])
            if gap <= reach * reach:
                return True
    return False


@inner_kernel
def are_pairs_apart(
    pairs: Indices,
    count: int,
    a: tuple[HullTable, Indices],
    b: tuple[HullTable, Indices],
    limits: Array,
    scratch: Scratch,
) -> bool:
    """Tell whether the first of some pairs are proved to keep their clearances.

    Args:
        pairs, count: see ``write_near_pairs``, and how many count.
        a, b: bodies on their motion, and their rows and columns in ``limits``.
        limits: least distances [m].
        scratch: work array.
    """
    (a_hulls, rows), (b_hulls, columns) = a, b
    scratch.posed[0] = scratch.posed[1] = -1
    for k in range(count):
        o, p = pairs[k] // len(columns), pairs[k] % len(columns)
        pose_segments(a_hulls, ZERO, b_hulls, ZERO, scratch)
        limit = limits[rows[o], columns[p]]
        if check_hulls_continuously(a_hulls, o, b_hulls, p, limit, scratch) != APART:
            return False
    return True


class MovingPair:
    """Checks two robots, with their loads, against each other.

    Args:
        cell: the static cell.
        first, second: names of the robots.
        state: what each of them holds.
        allowed: unordered pairs of entities that may touch.
        margin: added to the cell's clearances [m].
    """

    def __init__(
        self,
        cell: Workcell,
        first: str,
        second: str,
        state: WorldState,
        allowed: frozenset[frozenset[str]] = frozenset(),
        *,
        margin: float = 0.0,
    ) -> None:
        placed = [(item, state.attachments.get(item.name)) for item in cell.objects]
        one, two = (
            robot_bodies(cell.robot(name), objects_held_by(name, placed))
            for name in (first, second)
        )
        numbers = cell_entities(cell)
        between = cell.clearances.robot_robot + margin
        a, b = make_swept(one.hulls), make_swept(two.hulls)
        most = max(cell.robot(name).model.dof for name in (first, second))
        self._pair = packed(
            _Pair(
                a,
                b,
                one.numbered(numbers),
                two.numbered(numbers),
                limits_of_entities(numbers, between, allowed),
                between,
                np.empty(len(one.entities) * len(two.entities), dtype=np.int64),
                make_scratch(a.hulls, b.hulls),
                np.zeros((4, most)),
            )
        )

    def split(
        self, a_from: Array, a_to: Array, b_from: Array, b_to: Array, parts: int
    ) -> Array | None:
        """Cut a composite motion into parts, in each of which the robots are proved to keep clear.

        Args:
            a_from, a_to: ends of the first robot's motion, shape (n,).
            b_from, b_to: likewise for the second robot.
            parts: equal parts to start with.

        Returns:
            The parameters at which parts end, rising to 1, shape (k,) with k >= ``parts``; None
            when the robots come too close, or nearly so.
        """
        for row, q in enumerate((a_from, a_to, b_from, b_to)):
            self._pair.motion[row, : len(q)] = q
        ends = np.empty(parts << _HALVINGS)
        count = _split(self._pair, parts, ends)
        return ends[:count] if count >= 0 else None

    def clear(self, a_at: Array, b_at: Array) -> bool:
        """Tell whether both configurations are free of mutual collision, shapes (n,)."""
        return self.split(a_at, a_at, b_at, b_at, 1) is not None


class _Pair(NamedTuple):
    """Bodies of two robots on a stretch of their motions, for compiled code.

    Attributes:
        a, b: bodies of either.
        rows, columns: their entities.
        limits: least distances of entities, SKIP where a pair is not checked, shape (e, e) [m].
        widest: the greatest of them [m].
        near: work array for pairs.
        scratch: work array for the hulls.
        motion: ends of the motion of a, then of b, shape (4, at least n) [rad or m].
    """

    a: SweptBodies
    b: SweptBodies
    rows: Indices
    columns: Indices
    limits: Array
    widest: float
    near: Indices
    scratch: Scratch
    motion: Array


@inner_kernel
def _is_clear(pair: _Pair, lo: float, hi: float) -> bool:
    """Tell whether the robots are proved clear, each anywhere on a stretch of its motion."""
    a, b, motion = pair.a.hulls, pair.b.hulls, pair.motion
    n, m = a.q_a.shape[1], b.q_a.shape[1]
    set_stretch(a, motion[0, :n], motion[1, :n], lo, hi)
    set_stretch(b, motion[2, :m], motion[3, :m], lo, hi)
    sweep_bodies(pair.a)
    sweep_bodies(pair.b)
    one, other = (
        (a, pair.a.sweeps, ZERO, pair.rows),
        (b, pair.b.sweeps, ZERO, pair.columns),
    )
    return are_pieces_apart(
        one, other, pair.limits, pair.widest, pair.near, pair.scratch
    )


@kernel
def _split(pair: _Pair, parts: int, ends: Array) -> int:
    """Write where parts end; return their number, -1 when the robots come too close."""
    stack = np.empty((_HALVINGS + 2, 2))
    smallest = 1.0 / len(ends)
    count = 0
    for k in range(parts):
        stack[0, 0], stack[0, 1] = k / parts, (k + 1) / parts
        depth = 1
        while depth > 0:
            depth -= 1
            lo, hi = stack[depth, 0], stack[depth, 1]
            if _is_clear(pair, lo, hi):
                ends[count] = hi
                count += 1
                continue
            if hi - lo < 1.5 * smallest:
                return -1
            # What is not proved clear is looked at in its middle before it is halved.
            middle = 0.5 * (lo + hi)
            if not _is_clear(pair, middle, middle):
                return -1
            stack[depth, 0], stack[depth, 1] = middle, hi
            stack[depth + 1, 0], stack[depth + 1, 1] = lo, middle
            depth += 2
    return count
