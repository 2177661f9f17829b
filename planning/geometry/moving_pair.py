"""Two robots that move at once: do they stay clear of each other along a composite motion?

Both go straight in joint space with the same parameter. The motion is cut into parts; within
one each robot may be anywhere on its own stretch while the other is anywhere on its own. So the
parts can become nodes of a temporal plan graph: clearance and both robots' link motion are kept
node by node, and neither standing at the end of a part is in the way of the other. A part that
is too coarse for that is halved.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from planning.cell.compiled_robot import RobotKernel, robot_kernel
from planning.cell.workcell import Workcell, WorldState
from planning.geometry.distance import segment_segment
from planning.geometry.exact import Solid, carried_solid
from planning.geometry.hull_table import HullTable, hull_table
from planning.geometry.scene_checker import robot_solids
from planning.geometry.separation import (
    Scratch,
    hulls_stay_apart,
    make_scratch,
    pose_segments,
)
from planning.geometry.swept import place_capsules
from planning.transforms import Array, Indices

_SKIP = -1.0
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
        self._a, a_names, a_still = _bodies(cell, first, state)
        self._b, b_names, b_still = _bodies(cell, second, state)
        between = cell.clearances.robot_robot + margin
        to_objects = cell.clearances.robot_object + margin
        self._limit = np.full((len(a_names), len(b_names)), to_objects)
        parts = len(cell.robot(first).model.parts), len(cell.robot(second).model.parts)
        self._limit[: parts[0], : parts[1]] = between
        for i, x in enumerate(a_names):
            for j, y in enumerate(b_names):
                if frozenset((x, y)) in allowed or (a_still[i] and b_still[j]):
                    self._limit[i, j] = _SKIP
        self._scratch = make_scratch(self._a.hulls, self._b.hulls)

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
        ends = np.empty(parts << _HALVINGS)
        count = _split(
            self._a.kernel,
            self._a.first,
            self._a.hulls,
            self._b.kernel,
            self._b.first,
            self._b.hulls,
            self._limit,
            np.ascontiguousarray(a_from, dtype=np.float64),
            np.ascontiguousarray(a_to, dtype=np.float64),
            np.ascontiguousarray(b_from, dtype=np.float64),
            np.ascontiguousarray(b_to, dtype=np.float64),
            parts,
            _HALVINGS,
            self._scratch,
            ends,
        )
        return ends[:count] if count >= 0 else None

    def clear(self, a_at: Array, b_at: Array) -> bool:
        """Tell whether both robots may stand where they are, shapes (n,)."""
        return self.split(a_at, a_at, b_at, b_at, 1) is not None


class _Bodies:
    """The bodies of one robot, for compiled code."""

    def __init__(
        self, kernel: RobotKernel, solids: list[Solid], bodies: list[object]
    ) -> None:
        n = kernel.placement.shape[0]
        which = np.arange(len(solids), dtype=np.int32)[None]
        self.kernel = kernel
        self.first: Indices = np.searchsorted(
            kernel.body, np.arange(len(solids) + 1)
        ).astype(np.int64)
        self.hulls = hull_table(
            kernel,
            np.zeros((1, n)),
            np.zeros((1, n)),
            which,
            solids,
            bodies,  # type: ignore[arg-type]
        )


def _bodies(
    cell: Workcell, name: str, state: WorldState
) -> tuple[_Bodies, list[str], list[bool]]:
    """Return a robot's bodies, their entities, and which of them never move."""
    robot = cell.robot(name)
    held = [
        (item, state.attachments[item.name].pose)
        for item in cell.objects
        if item.name in state.attachments
        and state.attachments[item.name].holder == name
    ]
    # Writable copies: numba compiles read-only arrays anew.
    kernel = RobotKernel._make(
        np.array(v) for v in robot_kernel(robot, [(i.body, pose) for i, pose in held])
    )
    model = robot.model
    solids = robot_solids(robot, kernel) + [
        carried_solid(i.name, i.body, kernel, model.dof - 1, model.flange @ pose)
        for i, pose in held
    ]
    bodies: list[object] = [part.body for part in model.parts]
    bodies += [item.body for item, _ in held]
    still = [part.joint < 0 for part in model.parts] + [False] * len(held)
    names = [solid.name.split(":")[0] for solid in solids]
    return _Bodies(kernel, solids, bodies), names, still


@njit(cache=True, nogil=True)
def _bound(
    kernel: RobotKernel,
    first: Indices,
    start: Array,
    end: Array,
    moved: Array,
    bounds: Array,
) -> None:
    """Write the least and greatest corner of every body's swept capsules, shape (o, 6)."""
    for o in range(first.shape[0] - 1):
        for r in range(3):
            bounds[o, r] = np.inf
            bounds[o, r + 3] = -np.inf
        for c in range(first[o], first[o + 1]):
            grown = kernel.radius[c] + moved[c, 0]
            for r in range(3):
                bounds[o, r] = min(bounds[o, r], min(start[c, r], end[c, r]) - grown)
                bounds[o, r + 3] = max(
                    bounds[o, r + 3], max(start[c, r], end[c, r]) + grown
                )


@njit(cache=True, nogil=True)
def _near(
    a: RobotKernel,
    a_first: Indices,
    a_start: Array,
    a_end: Array,
    a_moved: Array,
    i: int,
    b: RobotKernel,
    b_first: Indices,
    b_start: Array,
    b_end: Array,
    b_moved: Array,
    j: int,
    limit: float,
) -> bool:
    """Tell whether the swept capsules of two bodies come closer than a limit."""
    for c in range(a_first[i], a_first[i + 1]):
        grown = a.radius[c] + a_moved[c, 0] + limit
        for d in range(b_first[j], b_first[j + 1]):
            near = grown + b.radius[d] + b_moved[d, 0]
            gap = segment_segment(a_start[c], a_end[c], b_start[d], b_end[d])
            if gap <= near * near:
                return True
    return False


@njit(cache=True, nogil=True)
def _split(
    a: RobotKernel,
    a_first: Indices,
    a_hulls: HullTable,
    b: RobotKernel,
    b_first: Indices,
    b_hulls: HullTable,
    limits: Array,
    a_from: Array,
    a_to: Array,
    b_from: Array,
    b_to: Array,
    parts: int,
    halvings: int,
    scratch: Scratch,
    ends: Array,
) -> int:
    """Write where parts end; return how many there are, -1 when the robots come too close."""
    n, m = a_from.shape[0], b_from.shape[0]
    a_start, a_end = np.empty((len(a.radius), 3)), np.empty((len(a.radius), 3))
    b_start, b_end = np.empty((len(b.radius), 3)), np.empty((len(b.radius), 3))
    a_moved, b_moved = (
        np.empty((len(a.radius), n + 1)),
        np.empty((len(b.radius), m + 1)),
    )
    a_poses, b_poses = np.empty((n + 1, 4, 4)), np.empty((m + 1, 4, 4))
    a_mid, b_mid = np.empty(n), np.empty(m)
    a_box, b_box = np.empty((len(a_first) - 1, 6)), np.empty((len(b_first) - 1, 6))
    a_step, b_step = a_to - a_from, b_to - b_from
    stack = np.empty((halvings + 2, 2))
    smallest = 1.0 / (parts * 2.0**halvings)
    count = 0
    for k in range(parts):
        stack[0, 0], stack[0, 1] = k / parts, (k + 1) / parts
        depth = 1
        while depth > 0:
            depth -= 1
            lo, hi = stack[depth]
            # A part that is not proved clear is looked at in its middle before it is halved.
            for attempt in range(2):
                x, y = lo, hi
                if attempt == 1:
                    x = y = 0.5 * (lo + hi)
                a0, a1 = a_from + x * a_step, a_from + y * a_step
                b0, b1 = b_from + x * b_step, b_from + y * b_step
                place_capsules(a, a0, a1, a_poses, a_mid, a_start, a_end, a_moved)
                place_capsules(b, b0, b1, b_poses, b_mid, b_start, b_end, b_moved)
                _bound(a, a_first, a_start, a_end, a_moved, a_box)
                _bound(b, b_first, b_start, b_end, b_moved, b_box)
                posed = False
                clear = True
                for i in range(len(a_box)):
                    for j in range(len(b_box)):
                        limit = limits[i, j]
                        if limit < 0.0 or _boxes_apart(a_box, i, b_box, j, limit):
                            continue
                        if not _near(
                            a,
                            a_first,
                            a_start,
                            a_end,
                            a_moved,
                            i,
                            b,
                            b_first,
                            b_start,
                            b_end,
                            b_moved,
                            j,
                            limit,
                        ):
                            continue
                        if not posed:
                            a_hulls.q_a[0], a_hulls.q_b[0] = a0, a1
                            b_hulls.q_a[0], b_hulls.q_b[0] = b0, b1
                            scratch.posed[0] = scratch.posed[1] = -1
                            pose_segments(a_hulls, 0, b_hulls, 0, scratch)
                            posed = True
                        if not hulls_stay_apart(
                            a_hulls, 0, i, b_hulls, 0, j, limit, scratch
                        ):
                            clear = False
                            break
                    if not clear:
                        break
                if clear:
                    break
                if attempt == 1 or hi - lo < 1.5 * smallest:
                    return -1
            if x == lo and y == hi:
                ends[count] = hi
                count += 1
                continue
            middle = 0.5 * (lo + hi)
            stack[depth, 0], stack[depth, 1] = middle, hi
            stack[depth + 1, 0], stack[depth + 1, 1] = lo, middle
            depth += 2
    return count


@njit(cache=True, inline="always")
def _boxes_apart(a: Array, i: int, b: Array, j: int, limit: float) -> bool:
    for r in range(3):
        if a[i, r] - b[j, r + 3] > limit or b[j, r] - a[i, r + 3] > limit:
            return True
    return False
