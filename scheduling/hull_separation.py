"""Separating planes of moving convex hulls, compiled: spares the exact decision what is apart.

GJK walks towards the shortest vector between two hulls. Any direction it tries proves a lower
bound of their distance (the gap between their supporting planes), whatever rounding does to the
walk. So "apart" is certain; everything else is left to the exact decision.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from planning.geometry.chain import joint_poses
from planning.geometry.kernel import RobotKernel
from planning.transforms import Array
from scheduling.temporal_plan_graph import Indices

AT_REST = -2
"""Stands for the joint of a body that rests in the world."""

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
        first: where the corners of a solid begin, shape (solids + 1,).
        joint: joint that carries a solid, -1 for the base, AT_REST for none, shape (solids,).
        corners: hull corners in the joint's frame, or in the world, shape (all, 3) [m].
    """

    kernel: RobotKernel
    q_a: Array
    q_b: Array
    solid: npt.NDArray[np.int32]
    first: Indices
    joint: Indices
    corners: Array


@njit(cache=True)
def _place(
    table: HullTable, solid: int, q_a: Array, q_b: Array, poses: Array, out: Array
) -> tuple[int, float]:
    """Write a body's corners at the middle of a motion; return their number and a bound.

    The bound is of how far any point of the body strays from its place in the middle; the
    argument is that of planning.geometry.swept.
    """
    first, last = table.first[solid], table.first[solid + 1]
    joint = table.joint[solid]
    count = last - first
    if joint == AT_REST:
        for v in range(count):
            for r in range(3):
                out[v, r] = table.corners[first + v, r]
        return count, 0.0
    kernel = table.kernel
    joint_poses(
        kernel.placement,
        kernel.axis,
        kernel.prismatic,
        kernel.base,
        0.5 * (q_a + q_b),
        poses,
    )
    pose = poses[joint + 1]
    for v in range(count):
        for r in range(3):
            total = pose[r, 3]
            for k in range(3):
                total += pose[r, k] * table.corners[first + v, k]
            out[v, r] = total
    moved = 0.0
    for j in range(joint, -1, -1):
        half_travel = 0.5 * abs(q_b[j] - q_a[j])
        if half_travel == 0.0:
            continue
        if kernel.prismatic[j]:
            moved += half_travel
            continue
        frame = poses[j + 1]
        ax = ay = az = 0.0
        for k in range(3):
            ax += frame[0, k] * kernel.axis[j, k]
            ay += frame[1, k] * kernel.axis[j, k]
            az += frame[2, k] * kernel.axis[j, k]
        reach = 0.0
        for v in range(count):
            x = out[v, 0] - frame[0, 3]
            y = out[v, 1] - frame[1, 3]
            z = out[v, 2] - frame[2, 3]
            cx, cy, cz = y * az - z * ay, z * ax - x * az, x * ay - y * ax
            reach = max(reach, cx * cx + cy * cy + cz * cz)
        moved += half_travel * (np.sqrt(reach) + moved)
    return count, moved


@njit(cache=True)
def _support(corners: Array, count: int, x: float, y: float, z: float) -> int:
    best, at = -np.inf, 0
    for v in range(count):
        d = x * corners[v, 0] + y * corners[v, 1] + z * corners[v, 2]
        if d > best:
            best, at = d, v
    return at


@njit(cache=True)
def apart_by(a: Array, a_count: int, b: Array, b_count: int, enough: float) -> bool:
    """Tell whether two hulls are proved to be at least ``enough`` apart [m].

    Args:
        a, a_count: corners of the one hull, the first ``a_count`` rows of shape (.., 3).
        b, b_count: likewise for the other.
        enough: the distance to prove; where it is not positive, disjoint hulls are.
    """
    target = max(enough, 0.0) + _ROUNDING
    simplex = np.empty((4, 3))
    size = 0
    v = np.zeros(3)
    for k in range(3):
        v[k] = a[0, k] - b[0, k]
    for _ in range(_STEPS):
        norm = np.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
        if norm < target:
            return False
        i = _support(a, a_count, -v[0], -v[1], -v[2])
        j = _support(b, b_count, v[0], v[1], v[2])
        w0, w1, w2 = a[i, 0] - b[j, 0], a[i, 1] - b[j, 1], a[i, 2] - b[j, 2]
        if (v[0] * w0 + v[1] * w1 + v[2] * w2) >= target * norm:
            return True
        for s in range(size):
            if simplex[s, 0] == w0 and simplex[s, 1] == w1 and simplex[s, 2] == w2:
                return False
        simplex[size, 0], simplex[size, 1], simplex[size, 2] = w0, w1, w2
        size = _nearest(simplex, size + 1, v)
        if size == 4:
            return False
    return False


@njit(cache=True)
def _nearest(simplex: Array, size: int, v: Array) -> int:
    """Write the point of a simplex nearest to the origin; keep only the corners it needs."""
    if size == 1:
        v[:] = simplex[0]
        return 1
    best = np.inf
    keep = np.zeros(4, dtype=np.int64)
    kept = 0
    weights = np.empty(3)
    near = np.empty(3)
    if size == 4 and _inside(simplex):
        v[:] = 0.0
        return 4
    # The nearest point lies on a face, an edge or a corner: the best of all that hold the
    # newest corner and whose own nearest point is inside them, and of the others as well.
    for mask in range(1, 1 << size):
        count = 0
        index = np.zeros(4, dtype=np.int64)
        for s in range(size):
            if mask & (1 << s):
                index[count] = s
                count += 1
        if count > 3 or not _project(simplex, index, count, weights):
            continue
        for k in range(3):
            near[k] = 0.0
            for s in range(count):
                near[k] += weights[s] * simplex[index[s], k]
        d = near[0] * near[0] + near[1] * near[1] + near[2] * near[2]
        if d < best:
            best = d
            v[:] = near
            kept = count
            for s in range(count):
                keep[s] = index[s]
    for s in range(kept):
        for k in range(3):
            simplex[s, k] = simplex[keep[s], k]
    return kept


@njit(cache=True)
def _project(simplex: Array, index: Indices, count: int, weights: Array) -> bool:
    """Write the weights of the origin's projection; False where it falls outside."""
    if count == 1:
        weights[0] = 1.0
        return True
    p = simplex[index[0]]
    if count == 2:
        q = simplex[index[1]]
        dd = dp = 0.0
        for k in range(3):
            e = q[k] - p[k]
            dd += e * e
            dp -= e * p[k]
        if dd <= 0.0 or dp < 0.0 or dp > dd:
            return False
        weights[1] = dp / dd
        weights[0] = 1.0 - weights[1]
        return True
    q, r = simplex[index[1]], simplex[index[2]]
    aa = ab = bb = ap = bp = 0.0
    for k in range(3):
        e, f = q[k] - p[k], r[k] - p[k]
        aa += e * e
        ab += e * f
        bb += f * f
        ap -= e * p[k]
        bp -= f * p[k]
    det = aa * bb - ab * ab
    if det <= 1e-14 * aa * bb:
        return False
    s, t = (bb * ap - ab * bp) / det, (aa * bp - ab * ap) / det
    if s < 0.0 or t < 0.0 or s + t > 1.0:
        return False
    weights[0], weights[1], weights[2] = 1.0 - s - t, s, t
    return True


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


@njit(cache=True)
def hulls_stay_apart(
    a: HullTable, s: int, i: int, b: HullTable, t: int, j: int, clearance: float
) -> bool:
    """Tell whether two bodies are proved to keep a clearance, each anywhere on its motion.

    Args:
        a, s, i: an occupancy, a segment of it and a body.
        b, t, j: likewise for the other.
        clearance: least distance [m]; where negative, 0 is proved or nothing.
    """
    x, y = a.solid[s, i], b.solid[t, j]
    poses_a = np.empty((a.q_a.shape[1] + 1, 4, 4))
    poses_b = np.empty((b.q_a.shape[1] + 1, 4, 4))
    corners_a = np.empty((a.first[x + 1] - a.first[x], 3))
    corners_b = np.empty((b.first[y + 1] - b.first[y], 3))
    step_a, step_b = a.q_b[s] - a.q_a[s], b.q_b[t] - b.q_a[t]
    stack = np.empty((64, 4))
    stack[0] = np.array([0.0, 1.0, 0.0, 1.0])
    depth = 1
    while depth > 0:
        depth -= 1
        a0, a1, b0, b1 = stack[depth]
        a_count, a_moved = _place(
            a, x, a.q_a[s] + a0 * step_a, a.q_a[s] + a1 * step_a, poses_a, corners_a
        )
        b_count, b_moved = _place(
            b, y, b.q_a[t] + b0 * step_b, b.q_a[t] + b1 * step_b, poses_b, corners_b
        )
        if apart_by(
            corners_a, a_count, corners_b, b_count, clearance + a_moved + b_moved
        ):
            continue
        if a_moved + b_moved < _FINEST or depth + 2 > 64:
            return False
        if not apart_by(corners_a, a_count, corners_b, b_count, clearance):
            return False
        if a_moved >= b_moved:
            middle = 0.5 * (a0 + a1)
            stack[depth] = np.array([a0, middle, b0, b1])
            stack[depth + 1] = np.array([middle, a1, b0, b1])
        else:
            middle = 0.5 * (b0 + b1)
            stack[depth] = np.array([a0, a1, b0, middle])
            stack[depth + 1] = np.array([a0, a1, middle, b1])
        depth += 2
    return True
