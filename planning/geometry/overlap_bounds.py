"""Proof that moving hulls keep a least distance from a box, or overlap it no deeper than allowed, in compiled code.

A hull overlaps a box at most as deep as it must be moved along the normal of one of the faces to leave the box. The
least of these six depths bounds the overlap with everything inside the box.
"""

from __future__ import annotations

import numpy as np

from planning.geometry.deviation_bounds import deviation_bound
from planning.geometry.hull_table import HullTable
from planning.kernels import inner_kernel, kernel
from planning.kinematics.chain import pose_joints
from planning.transforms import Array, Indices

_FINEST = 1.0 / 256.0
"""Share of a motion that is not divided further."""


@kernel
def closest_at_waypoint(
    hulls: HullTable, bodies: Indices, path: Array, pose: Array, half: Array
) -> tuple[int, int, float]:
    """Return the body that seems closest to a box at the waypoints of a path.

    Args:
        hulls, bodies, path, pose, half: see ``find_unproved``.

    Returns:
        The body, the waypoint, and a lower bound of the distance of all bodies at all waypoints [m].
    """
    poses = np.empty((path.shape[1] + 1, 4, 4))
    least, closest, where = np.inf, -1, -1
    for s in range(len(path)):
        pose_joints(hulls.robot, path[s], poses)
        for o in bodies:
            gap = _gap_bound(hulls, o, poses, pose, half)
            if gap < least:
                least, closest, where = gap, o, s
    return closest, where, least


@kernel
def find_unproved(
    hulls: HullTable,
    bodies: Indices,
    path: Array,
    pose: Array,
    half: Array,
    limit: float,
    out: Array,
) -> int:
    """Find the stretches of a path on which bodies are not proved to keep a least distance from a box.

    Base errors and deviations from the path are ignored.

    Args:
        hulls: bodies that a robot carries.
        bodies: those that are checked.
        path: waypoints of straight joint-space motions, shape (w, n).
        pose, half: of the box, shapes (4, 4) and (3,) [m].
        limit: least distance, negative for an allowed overlap [m].
        out: receives rows (body, motion, begin, end) of the stretches, the latter two as shares of the motion,
            shape (m, 4).

    Returns:
        The number of stretches; m if there may be more.
    """
    n, found = path.shape[1], 0
    poses, q = np.empty((n + 1, 4, 4)), np.empty(n)
    travel, straight = np.empty(n), np.zeros(n)
    stack = np.empty((64, 2))
    for s in range(len(path) - 1):
        stack[0, 0], stack[0, 1] = 0.0, 1.0
        depth = 1
        while depth > 0:
            depth -= 1
            lo, hi = stack[depth, 0], stack[depth, 1]
            for j in range(n):
                step = path[s + 1, j] - path[s, j]
                q[j] = path[s, j] + 0.5 * (lo + hi) * step
                travel[j] = (hi - lo) * abs(step)
            pose_joints(hulls.robot, q, poses)
            for o in bodies:
                moved = deviation_bound(hulls, o, travel, straight, poses)[0]
                if _gap_bound(hulls, o, poses, pose, half) - moved >= limit:
                    continue
                if hi - lo > _FINEST:
                    middle = 0.5 * (lo + hi)
                    stack[depth, 0], stack[depth, 1] = middle, hi
                    stack[depth + 1, 0], stack[depth + 1, 1] = lo, middle
                    depth += 2
                    break
                if found == len(out):
                    return found
                out[found, 0], out[found, 1] = o, s
                out[found, 2], out[found, 3] = lo, hi
                found += 1
    return found


@inner_kernel
def _gap_bound(
    hulls: HullTable, body: int, poses: Array, pose: Array, half: Array
) -> float:
    """Return a lower bound of the signed distance of a body from a box [m].

    Args:
        hulls: bodies that a robot carries.
        body: one of them.
        poses: of the joints, shape (n + 1, 4, 4).
        pose, half: of the box, shapes (4, 4) and (3,) [m].
    """
    p, corners = hulls.joint[body] + 1, hulls.corners
    first, last = hulls.corner_first[body], hulls.corner_first[body + 1]
    bound = -np.inf
    for k in range(3):
        # An axis of the box in the frame of the joint, and how far the middle of the box is along it.
        x = y = z = middle = 0.0
        for r in range(3):
            x += pose[r, k] * poses[p, r, 0]
            y += pose[r, k] * poses[p, r, 1]
            z += pose[r, k] * poses[p, r, 2]
            middle += pose[r, k] * (pose[r, 3] - poses[p, r, 3])
        low, high = np.inf, -np.inf
        for v in range(first, last):
            at = x * corners[v, 0] + y * corners[v, 1] + z * corners[v, 2]
            low, high = min(low, at), max(high, at)
        bound = max(bound, low - middle - half[k], middle - high - half[k])
    return bound
