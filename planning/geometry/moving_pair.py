"""Collision checks of two robots that move at once along a composite motion.

Both go straight in joint space with the same parameter. The motion is cut into parts; within
one each robot may be anywhere on its own stretch while the other is anywhere on its own. So the
parts can become nodes of a temporal plan graph: clearance and both robots' link motion are kept
node by node, and neither standing at the end of a part is in the way of the other. A part that
is too coarse for that is halved.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planning.cell.workcell import Workcell, WorldState
from planning.geometry.distance import boxes_apart
from planning.geometry.robot_bodies import held_by, robot_bodies
from planning.geometry.separation import (
    APART,
    Scratch,
    judge_hulls,
    make_scratch,
    pose_segments,
)
from planning.geometry.swept import (
    NOWHERE,
    SKIP,
    SweptBodies,
    make_swept,
    strays_where_they_meet,
    sweep_bodies,
)
from planning.kernels import ZERO, inner_kernel, kernel
from planning.packed import packed
from planning.transforms import Array

_HALVINGS = 5
"""How often a part is halved before the robots are called too close."""


class MovingPair:
    """Checks two robots, and what they hold, against each other.

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
            robot_bodies(cell.robot(name), held_by(name, placed))
            for name in (first, second)
        )
        between = cell.clearances.robot_robot + margin
        limits = np.full((len(one.entities), len(two.entities)), between)
        for i, x in enumerate(one.entities):
            for j, y in enumerate(two.entities):
                still = one.hulls.joint[i] < 0 and two.hulls.joint[j] < 0
                if still or frozenset((x, y)) in allowed:
                    limits[i, j] = SKIP
        a, b = make_swept(one.hulls), make_swept(two.hulls)
        most = max(cell.robot(name).model.dof for name in (first, second))
        scratch = make_scratch(a.hulls, b.hulls)
        self._pair = packed(_Pair(a, b, limits, scratch, np.zeros((4, most))))

    def split(
        self, a_from: Array, a_to: Array, b_from: Array, b_to: Array, parts: int
    ) -> Array | None:
        """Cut a composite motion into parts in which the robots cannot come close.

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
        """Tell whether both robots may stand where they are, shapes (n,)."""
        return self.split(a_at, a_at, b_at, b_at, 1) is not None


class _Pair(NamedTuple):
    """Bodies of two robots on a stretch of their motions, for compiled code.

    Attributes:
        a, b: bodies of either.
        limits: least distances, SKIP where a pair is not checked, shape (o, p) [m].
        scratch: room for the hulls.
        motion: ends of the motion of a, then of b, shape (4, at least n) [rad or m].
    """

    a: SweptBodies
    b: SweptBodies
    limits: Array
    scratch: Scratch
    motion: Array


@inner_kernel
def _is_clear(pair: _Pair, lo: float, hi: float) -> bool:
    """Tell whether the robots are proved clear, each anywhere on a stretch of its motion."""
    a, b, limits = pair.a, pair.b, pair.limits
    scratch, motion = pair.scratch, pair.motion
    n, m = a.hulls.q_a.shape[1], b.hulls.q_a.shape[1]
    sweep_bodies(a, motion[0, :n], motion[1, :n], lo, hi)
    sweep_bodies(b, motion[2, :m], motion[3, :m], lo, hi)
    scratch.posed[0] = scratch.posed[1] = -1
    for i in range(len(a.box)):
        for j in range(len(b.box)):
            limit = limits[i, j]
            if limit < 0.0 or boxes_apart(a.box, i, b.box, j, limit):
                continue
            if strays_where_they_meet(a, i, b, j, ZERO, limit, NOWHERE) == NOWHERE:
                continue
            pose_segments(a.hulls, ZERO, b.hulls, ZERO, scratch)
            if judge_hulls(a.hulls, i, b.hulls, j, limit, scratch) != APART:
                return False
    return True


@kernel
def _split(pair: _Pair, parts: int, ends: Array) -> int:
    """Write where parts end; return how many there are, -1 when the robots come too close."""
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
