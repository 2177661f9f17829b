"""Proof that moving hulls keep a least distance from a box, or overlap it no deeper than allowed, in compiled code.

A hull overlaps a box at most as deep as it must be moved along some axis to leave the box. The least of these depths
along the axes of the box, and one more axis for each hull, bounds the overlap with everything inside the box.
"""

from __future__ import annotations

import numpy as np

from planning.geometry.deviation_bounds import deviation_bound
from planning.geometry.hull_table import HullTable
from planning.kernels import inner_kernel, kernel
from planning.kinematics.chain import pose_joints
from planning.transforms import Array, Indices

_FINEST = 1.0 / 4096.0
"""Share of a motion that is not divided further."""


@kernel
def find_unproved(
    hulls: HullTable,
    bodies: Indices,
    axes: Array,
    path: Array,
    pose: Array,
    half: Array,
    limit: float,
) -> tuple[int, int, float]:
    """Find a body that is not proved to keep a least distance from a box on a path.

    Base errors and deviations from the path are ignored.

    Args:
        hulls: bodies that a robot carries.
        bodies: those that are checked.
        axes: one more axis for each of them, in the frame of its joint, zeros for none, shape (bodies, 3).
        path: waypoints of straight joint-space motions, shape (w, n).
        pose, half: of the box, shapes (4, 4) and (3,) [m].
        limit: least distance, negative for an allowed overlap [m].

    Returns:
        The index of the body, the motion, and where on it, as a share: the waypoint where a body seems deepest, or a
        place between waypoints. The index is -1 if all bodies are proved to keep the distance.
    """
    n = path.shape[1]
    poses, q = np.empty((n + 1, 4, 4)), np.empty(n)
    travel, straight = np.empty(n), np.zeros(n)
    least, found, where = limit, -1, 0
    for s in range(len(path)):
        pose_joints(hulls.robot, path[s], poses)
        for k in range(len(bodies)):
            gap = _gap_bound(hulls, bodies[k], axes[k], poses, pose, half)
            if gap < least:
                least, found, where = gap, k, s
    if found >= 0:
        return found, max(where - 1, 0), 1.0 if where > 0 else 0.0
    stack = np.empty((64, 2))
    for s in range(len(path) - 1):
        stack[0, 0], stack[0, 1] = 0.0, 1.0
        depth = 1
        while depth > 0:
            depth -= 1
            lo, hi = stack[depth, 0], stack[depth, 1]
            middle = 0.5 * (lo + hi)
            for j in range(n):
                step = path[s + 1, j] - path[s, j]
                q[j] = path[s, j] + middle * step
                travel[j] = (hi - lo) * abs(step)
            pose_joints(hulls.robot, q, poses)
            for k in range(len(bodies)):
                gap = _gap_bound(hulls, bodies[k], axes[k], poses, pose, half)
                moved = deviation_bound(hulls, bodies[k], travel, straight, poses)[0]
                if gap - moved >= limit:
                    continue
                if gap < limit or hi - lo <= _FINEST:
                    return k, s, middle
                stack[depth, 0], stack[depth, 1] = middle, hi
                stack[depth + 1, 0], stack[depth + 1, 1] = lo, middle
                depth += 2
                break
    return -1, 0, 0.0


@inner_kernel
def _gap_bound(
    hulls: HullTable, body: int, axis: Array, poses: Array, pose: Array, half: Array
) -> float:
    """Return a lower bound of the signed distance of a body from a box [m].

    Args:
        hulls: bodies that a robot carries.
        body: one of them.
        axis: one more axis in the frame of the joint, zeros for none, shape (3,).
        poses: of the joints, shape (n + 1, 4, 4).
        pose, half: of the box, shapes (4, 4) and (3,) [m].
    """
    p, corners = hulls.joint[body] + 1, hulls.corners
    first, last = hulls.corner_first[body], hulls.corner_first[body + 1]
    bound = -np.inf
    for k in range(4):
        if k == 3 and axis[0] == 0.0 and axis[1] == 0.0 and axis[2] == 0.0:
            break
        # The axis in the frame of the joint; the middle of the box along it, and how far the box reaches from there.
        x = y = z = middle = r0 = r1 = r2 = 0.0
        for r in range(3):
            if k == 3:
                w = poses[p, r, 0] * axis[0] + poses[p, r, 1] * axis[1]
                w += poses[p, r, 2] * axis[2]
            else:
                w = pose[r, k]
            x += w * poses[p, r, 0]
            y += w * poses[p, r, 1]
            z += w * poses[p, r, 2]
            middle += w * (pose[r, 3] - poses[p, r, 3])
            r0 += w * pose[r, 0]
            r1 += w * pose[r, 1]
            r2 += w * pose[r, 2]
        reach = abs(r0) * half[0] + abs(r1) * half[1] + abs(r2) * half[2]
        low, high = np.inf, -np.inf
        for v in range(first, last):
            at = x * corners[v, 0] + y * corners[v, 1] + z * corners[v, 2]
            low, high = min(low, at), max(high, at)
        bound = max(bound, low - middle - reach, middle - high - reach)
    return bound
