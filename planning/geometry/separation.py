"""Separating planes of moving convex hulls, compiled: spares the exact decision what is apart.

GJK walks towards the shortest vector between two hulls. Any direction it tries proves a lower
bound of their distance (the gap between their supporting planes), whatever rounding does to the
walk. So "apart" is certain; everything else is left to the exact decision.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from planning.geometry.body import ConvexBody
from planning.geometry.chain import joint_poses
from planning.geometry.exact import Solid
from planning.geometry.kernel import RobotKernel
from planning.transforms import Array, Transform

Indices = npt.NDArray[np.int64]

AT_REST = -2
"""Stands for the joint of a body that rests in the world."""

FAR, BETWEEN, CLOSE = 1, 0, -1

_STEPS = 24
_FINEST = 2e-4
_ROUNDING = 1e-9


class HullTable(NamedTuple):
    """The bodies of an occupancy, for compiled code.

    Attributes:
        kernel: the robot.
        q_a, q_b: ends of the segments, shape (s, n).
        solid: index of the solid of every body of every segment, -1 for none, shape
            (s, bodies).
        joint: joint that carries a solid, -1 for the base, AT_REST for none, shape (solids,).
        corner_first: where the corners of a solid begin, shape (solids + 1,).
        corners: hull corners in the joint's frame, or in the world, shape (all, 3) [m].
        capsule_first: where the capsules of a solid begin, shape (solids + 1,).
        ends: capsule starts and ends in the same frame, shape (capsules, 2, 3) [m].
        radius: capsule radii, shape (capsules,) [m].
    """

    kernel: RobotKernel
    q_a: Array
    q_b: Array
    solid: npt.NDArray[np.int32]
    joint: Indices
    corner_first: Indices
    corners: Array
    capsule_first: Indices
    ends: Array
    radius: Array


def hull_table(
    kernel: RobotKernel,
    q_a: Array,
    q_b: Array,
    solid: npt.NDArray[np.int32],
    solids: Sequence[Solid],
    bodies: Sequence[ConvexBody],
) -> HullTable:
    """Collect bodies for compiled code.

    Args:
        kernel: the robot that carries them; any, where none does.
        q_a, q_b: ends of the segments, shape (s, n).
        solid: index of the solid of every body of every segment, shape (s, bodies).
        solids: the bodies as solids.
        bodies: the same ones with their capsules.
    """
    placed = [
        placed_capsules(body, item.local)
        for item, body in zip(solids, bodies, strict=True)
    ]
    # There may be no bodies at all: a robot alone in an empty cell.
    none = np.empty((0, 3))
    starts, ends = [none, *(p[0] for p in placed)], [none, *(p[1] for p in placed)]
    corners = [
        s.vertices
        if s.carrier is not None
        else s.vertices @ s.local[:3, :3].T + s.local[:3, 3]
        for s in solids
    ]
    return HullTable(
        kernel,
        q_a,
        q_b,
        solid,
        np.array(
            [AT_REST if s.carrier is None else s.joint for s in solids], dtype=np.int64
        ),
        np.cumsum([0, *(len(c) for c in corners)]).astype(np.int64),
        np.ascontiguousarray(np.concatenate([none, *corners])),
        np.cumsum([0, *(len(b.capsules.radius) for b in bodies)]).astype(np.int64),
        np.ascontiguousarray(
            np.stack([np.concatenate(starts), np.concatenate(ends)], 1)
        ),
        np.concatenate([np.empty(0), *(b.capsules.radius for b in bodies)]),
    )


def placed_capsules(body: ConvexBody, pose: Transform) -> tuple[Array, Array, Array]:
    """Return starts, ends and radii of a body's capsules at a pose, in writable arrays."""
    turn, shift = pose[:3, :3].T, pose[:3, 3]
    capsules = body.capsules
    return (
        capsules.start @ turn + shift,
        capsules.end @ turn + shift,
        np.array(capsules.radius),
    )


@njit(cache=True)
def _pose(table: HullTable, q: Array, poses: Array) -> None:
    """Write the joint poses at a configuration."""
    kernel = table.kernel
    joint_poses(kernel.placement, kernel.axis, kernel.prismatic, kernel.base, q, poses)


@njit(cache=True)
def _place(table: HullTable, solid: int, poses: Array, out: Array, offset: int) -> int:
    """Write a body's corners from row ``offset`` on; return how many there are then."""
    first, last = table.corner_first[solid], table.corner_first[solid + 1]
    joint = table.joint[solid]
    if joint == AT_REST:
        for v in range(first, last):
            for r in range(3):
                out[offset + v - first, r] = table.corners[v, r]
        return int(offset + last - first)
    pose = poses[joint + 1]
    for v in range(first, last):
        for r in range(3):
            total = pose[r, 3]
            for k in range(3):
                total += pose[r, k] * table.corners[v, k]
            out[offset + v - first, r] = total
    return int(offset + last - first)


@njit(cache=True)
def _stray(
    table: HullTable, solid: int, q_a: Array, q_b: Array, poses: Array
) -> tuple[float, float]:
    """Return how far any point of a body strays on a motion, at most.

    First from its place in the middle of the motion (``poses``): the argument of
    planning.geometry.swept. Second from the straight line between its places at the ends: an
    eighth of its largest second derivative, to which each pair of joints adds the product of
    their travels times the point's distance from the axis of the one nearer to the tip.
    """
    joint = table.joint[solid]
    if joint == AT_REST:
        return 0.0, 0.0
    kernel = table.kernel
    pose = poses[joint + 1]
    first, last = table.capsule_first[solid], table.capsule_first[solid + 1]
    moved = bend = 0.0
    for j in range(joint, -1, -1):
        travel = abs(q_b[j] - q_a[j])
        if travel == 0.0:
            continue
        turned = 0.0
        for i in range(j):
            if not kernel.prismatic[i]:
                turned += abs(q_b[i] - q_a[i])
        if kernel.prismatic[j]:
            moved += 0.5 * travel
            bend += 2.0 * travel * turned
            continue
        frame = poses[j + 1]
        ax = ay = az = 0.0
        for k in range(3):
            ax += frame[0, k] * kernel.axis[j, k]
            ay += frame[1, k] * kernel.axis[j, k]
            az += frame[2, k] * kernel.axis[j, k]
        reach = 0.0
        for c in range(first, last):
            for e in range(2):
                x = pose[0, 3] - frame[0, 3]
                y = pose[1, 3] - frame[1, 3]
                z = pose[2, 3] - frame[2, 3]
                for k in range(3):
                    x += pose[0, k] * table.ends[c, e, k]
                    y += pose[1, k] * table.ends[c, e, k]
                    z += pose[2, k] * table.ends[c, e, k]
                cx, cy, cz = y * az - z * ay, z * ax - x * az, x * ay - y * ax
                far = np.sqrt(cx * cx + cy * cy + cz * cz) + table.radius[c]
                reach = max(reach, far)
        reach += moved
        moved += 0.5 * travel * reach
        bend += travel * (travel + 2.0 * turned) * reach
    return moved, 0.125 * bend


@njit(cache=True)
def _support(corners: Array, count: int, x: float, y: float, z: float) -> int:
    best, at = -np.inf, 0
    for v in range(count):
        d = x * corners[v, 0] + y * corners[v, 1] + z * corners[v, 2]
        if d > best:
            best, at = d, v
    return at


@njit(cache=True)
def gap_class(
    a: Array, a_count: int, b: Array, b_count: int, clearance: float, enough: float
) -> int:
    """Tell how far apart two hulls are.

    Args:
        a, a_count: corners of the one hull, the first ``a_count`` rows of shape (.., 3).
        b, b_count: likewise for the other.
        clearance: below this they are too close [m]; where not positive, when they overlap.
        enough: from this on they are far enough, at least ``clearance`` [m].

    Returns:
        FAR when they are proved to be at least ``enough`` apart, CLOSE when they are closer
        than ``clearance`` or that cannot be ruled out, BETWEEN otherwise.
    """
    near = max(clearance, 0.0) + _ROUNDING
    far = max(enough, 0.0) + _ROUNDING
    simplex = np.empty((4, 3))
    size = 0
    lower = -1.0
    v = np.zeros(3)
    for k in range(3):
        for i in range(a_count):
            v[k] += a[i, k] / a_count
        for j in range(b_count):
            v[k] -= b[j, k] / b_count
    for _ in range(_STEPS):
        norm = np.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
        # From the second round on v is a point of the difference: its length bounds the gap.
        if norm < near:
            break
        if lower >= near and size > 0 and norm < far:
            return BETWEEN
        i = _support(a, a_count, -v[0], -v[1], -v[2])
        j = _support(b, b_count, v[0], v[1], v[2])
        w0, w1, w2 = a[i, 0] - b[j, 0], a[i, 1] - b[j, 1], a[i, 2] - b[j, 2]
        lower = max(lower, (v[0] * w0 + v[1] * w1 + v[2] * w2) / norm)
        if lower >= far:
            return FAR
        again = False
        for s in range(size):
            if simplex[s, 0] == w0 and simplex[s, 1] == w1 and simplex[s, 2] == w2:
                again = True
        if again:
            break
        simplex[size, 0], simplex[size, 1], simplex[size, 2] = w0, w1, w2
        size = _nearest(simplex, size + 1, v)
        if size == 4:
            return CLOSE
    return BETWEEN if lower >= near else CLOSE


@njit(cache=True)
def _nearest(simplex: Array, size: int, v: Array) -> int:
    """Write the point of a simplex nearest to the origin; keep only the corners it needs.

    The newest corner is the last one. Every face, edge and corner is tried, and of those that
    hold the origin's projection the nearest wins: few operations, and no case to get wrong.
    """
    if size == 4 and _inside(simplex):
        return 4
    best = np.inf
    ki, kj, kk = 0, -1, -1
    wi, wj, wk = 1.0, 0.0, 0.0
    for i in range(size):
        p0, p1, p2 = simplex[i, 0], simplex[i, 1], simplex[i, 2]
        pp = p0 * p0 + p1 * p1 + p2 * p2
        if pp < best:
            best, ki, kj, kk, wi = pp, i, -1, -1, 1.0
        for j in range(i + 1, size):
            e0, e1, e2 = simplex[j, 0] - p0, simplex[j, 1] - p1, simplex[j, 2] - p2
            ee = e0 * e0 + e1 * e1 + e2 * e2
            ep = -(e0 * p0 + e1 * p1 + e2 * p2)
            if 0.0 < ep < ee:
                d = pp - ep * ep / ee
                if d < best:
                    best, ki, kj, kk = d, i, j, -1
                    wj = ep / ee
                    wi = 1.0 - wj
            for k in range(j + 1, size):
                f0 = simplex[k, 0] - p0
                f1 = simplex[k, 1] - p1
                f2 = simplex[k, 2] - p2
                ff = f0 * f0 + f1 * f1 + f2 * f2
                ef = e0 * f0 + e1 * f1 + e2 * f2
                fp = -(f0 * p0 + f1 * p1 + f2 * p2)
                det = ee * ff - ef * ef
                if det <= 1e-14 * ee * ff:
                    continue
                x, y = (ff * ep - ef * fp) / det, (ee * fp - ef * ep) / det
                if x <= 0.0 or y <= 0.0 or x + y >= 1.0:
                    continue
                d = pp - x * ep - y * fp
                if d < best:
                    best, ki, kj, kk = d, i, j, k
                    wi, wj, wk = 1.0 - x - y, x, y
    for r in range(3):
        v[r] = wi * simplex[ki, r]
        if kj >= 0:
            v[r] += wj * simplex[kj, r]
        if kk >= 0:
            v[r] += wk * simplex[kk, r]
    # ki < kj < kk: nothing is overwritten before it is read.
    kept = 1
    for r in range(3):
        simplex[0, r] = simplex[ki, r]
    if kj >= 0:
        kept = 2
        for r in range(3):
            simplex[1, r] = simplex[kj, r]
    if kk >= 0:
        kept = 3
        for r in range(3):
            simplex[2, r] = simplex[kk, r]
    return kept


@njit(cache=True)
def _inside(simplex: Array) -> bool:
    """Tell whether the origin is inside a tetrahedron."""
    side = np.empty(4)
    for s in range(4):
        p = simplex[(s + 1) % 4]
        q = simplex[(s + 2) % 4]
        r = simplex[(s + 3) % 4]
        ux, uy, uz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
        wx, wy, wz = r[0] - p[0], r[1] - p[1], r[2] - p[2]
        nx, ny, nz = uy * wz - uz * wy, uz * wx - ux * wz, ux * wy - uy * wx
        origin = -(nx * p[0] + ny * p[1] + nz * p[2])
        o = simplex[s]
        corner = nx * (o[0] - p[0]) + ny * (o[1] - p[1]) + nz * (o[2] - p[2])
        side[s] = origin * corner
    return bool(side[0] >= 0 and side[1] >= 0 and side[2] >= 0 and side[3] >= 0)


class Scratch(NamedTuple):
    """Room to work in.

    Attributes:
        whole_a, whole_b: joint poses at the middle of whole segments, shape (n + 1, 4, 4).
        part_a, part_b: joint poses elsewhere.
        corners_a, corners_b: shape (twice the most corners of a solid, 3).
        stack: parts still to be looked at, shape (64, 4).
        posed: the segments that ``whole_a`` and ``whole_b`` belong to, shape (2,).
        where: shares of both motions at which two bodies were not proved apart, shape (2,).
    """

    whole_a: Array
    whole_b: Array
    part_a: Array
    part_b: Array
    corners_a: Array
    corners_b: Array
    stack: Array
    posed: Indices
    where: Array


def make_scratch(a: HullTable, b: HullTable) -> Scratch:
    """Return room for the bodies of two occupancies."""
    n, m = a.q_a.shape[1] + 1, b.q_a.shape[1] + 1
    return Scratch(
        np.empty((n, 4, 4)),
        np.empty((m, 4, 4)),
        np.empty((n, 4, 4)),
        np.empty((m, 4, 4)),
        np.empty((2 * int(np.max(np.diff(a.corner_first), initial=0)), 3)),
        np.empty((2 * int(np.max(np.diff(b.corner_first), initial=0)), 3)),
        np.empty((64, 4)),
        np.full(2, -1, dtype=np.int64),
        np.empty(2),
    )


@njit(cache=True)
def pose_segments(a: HullTable, s: int, b: HullTable, t: int, scratch: Scratch) -> None:
    """Prepare two segments for ``hulls_stay_apart``."""
    if scratch.posed[0] != s:
        _pose(a, 0.5 * (a.q_a[s] + a.q_b[s]), scratch.whole_a)
        scratch.posed[0] = s
    if scratch.posed[1] != t:
        _pose(b, 0.5 * (b.q_a[t] + b.q_b[t]), scratch.whole_b)
        scratch.posed[1] = t


@njit(cache=True)
def hulls_stay_apart(
    a: HullTable,
    s: int,
    i: int,
    b: HullTable,
    t: int,
    j: int,
    clearance: float,
    scratch: Scratch,
) -> bool:
    """Tell whether two bodies are proved to keep a clearance, each anywhere on its motion.

    Args:
        a, s, i: an occupancy, a segment of it and a body.
        b, t, j: likewise for the other.
        clearance: least distance [m]; where negative, 0 is proved or nothing.
        scratch: after ``pose_segments`` for s and t; where the answer is False, ``where``
            says where they come close.
    """
    x, y = a.solid[s, i], b.solid[t, j]
    corners_a, corners_b, stack = scratch.corners_a, scratch.corners_b, scratch.stack
    step_a, step_b = a.q_b[s] - a.q_a[s], b.q_b[t] - b.q_a[t]
    stack[0, 0] = stack[0, 2] = 0.0
    stack[0, 1] = stack[0, 3] = 1.0
    depth = 1
    while depth > 0:
        depth -= 1
        a0, a1, b0, b1 = stack[depth]
        from_a, to_a = a.q_a[s] + a0 * step_a, a.q_a[s] + a1 * step_a
        from_b, to_b = b.q_a[t] + b0 * step_b, b.q_a[t] + b1 * step_b
        poses_a, poses_b = scratch.whole_a, scratch.whole_b
        if a1 - a0 < 1.0:
            poses_a = scratch.part_a
            _pose(a, 0.5 * (from_a + to_a), poses_a)
        if b1 - b0 < 1.0:
            poses_b = scratch.part_b
            _pose(b, 0.5 * (from_b + to_b), poses_b)
        a_moved, a_bend = _stray(a, x, from_a, to_a, poses_a)
        b_moved, b_bend = _stray(b, y, from_b, to_b, poses_b)
        gap = gap_class(
            corners_a,
            _place(a, x, poses_a, corners_a, 0),
            corners_b,
            _place(b, y, poses_b, corners_b, 0),
            clearance,
            clearance + a_moved + b_moved,
        )
        if gap == FAR:
            continue
        if gap == CLOSE or a_moved + b_moved < _FINEST or depth + 2 > len(stack):
            scratch.where[0], scratch.where[1] = 0.5 * (a0 + a1), 0.5 * (b0 + b1)
            return False
        # The hull of a body's places at both ends holds all in between, but for the bend.
        a_count = _place_ends(a, x, from_a, to_a, scratch.part_a, corners_a)
        b_count = _place_ends(b, y, from_b, to_b, scratch.part_b, corners_b)
        enough = clearance + a_bend + b_bend
        if gap_class(corners_a, a_count, corners_b, b_count, enough, enough) == FAR:
            continue
        for k in range(2):
            for c in range(4):
                stack[depth + k, c] = (a0, a1, b0, b1)[c]
        if a_moved >= b_moved:
            stack[depth, 1] = stack[depth + 1, 0] = 0.5 * (a0 + a1)
        else:
            stack[depth, 3] = stack[depth + 1, 2] = 0.5 * (b0 + b1)
        depth += 2
    return True


@njit(cache=True)
def _place_ends(
    table: HullTable, solid: int, q_a: Array, q_b: Array, poses: Array, out: Array
) -> int:
    """Write a body's corners at both ends of a motion; return how many there are."""
    if table.joint[solid] == AT_REST:
        return _place(table, solid, poses, out, 0)
    _pose(table, q_a, poses)
    count = _place(table, solid, poses, out, 0)
    _pose(table, q_b, poses)
    return _place(table, solid, poses, out, count)


@njit(cache=True)
def not_proved_apart(
    a: HullTable,
    b: HullTable,
    q_a: Array,
    q_b: Array,
    when: Array,
    pairs: Indices,
    limits: Array,
    scratch: Scratch,
) -> Indices:
    """Return which proposed pairs of a moving and a standing body are not proved apart.

    Args:
        a: the moving bodies, one segment; its ends are overwritten.
        b: the standing bodies, one segment.
        q_a, q_b: ends of the whole motion, shape (n,).
        when: stretches of it as parameters in [0, 1], shape (k, 2).
        pairs: body of a and body of b that may touch in each, shape (k, 2).
        limits: least distances, shape (k,) [m].
        scratch: room to work in.

    Returns:
        Rows of ``pairs``, rising.
    """
    left = np.empty(len(when), dtype=np.int64)
    count = 0
    lo = hi = -1.0
    for k in range(len(when)):
        if when[k, 0] != lo or when[k, 1] != hi:
            lo, hi = when[k]
            a.q_a[0] = q_a + lo * (q_b - q_a)
            a.q_b[0] = q_a + hi * (q_b - q_a)
            scratch.posed[0] = -1
            pose_segments(a, 0, b, 0, scratch)
        i, j = pairs[k]
        if not hulls_stay_apart(a, 0, i, b, 0, j, limits[k], scratch):
            left[count] = k
            count += 1
    return left[:count]
