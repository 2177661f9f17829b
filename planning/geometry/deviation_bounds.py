"""Bounds on how far points of a moving convex hull deviate from straight lines between its end poses."""

from __future__ import annotations

import numpy as np

from planning.geometry.hull_table import AT_REST, HullTable
from planning.kernels import inner_kernel
from planning.kinematics.chain import joint_axis
from planning.packed import stack_rows
from planning.transforms import Array

_STACK_POINTS = 32
"""Number of capsule ends for which stack memory is sufficient; few bodies have more."""


@inner_kernel
def deviation_bound_with_base(table: HullTable, solid: int, poses: Array) -> float:
    """Return the largest displacement of any point of a body by base error and deviation [m].

    Args:
        table: the bodies.
        solid: the body.
        poses: joint poses.
    """
    error, joint = table.robot.error, table.joint[solid]
    if joint == AT_REST or (error[0] == 0.0 and error[1] == 0.0):
        return float(table.deviates[solid])
    far, corners = 0.0, table.corners
    for v in range(table.corner_first[solid], table.corner_first[solid + 1]):
        away = 0.0
        for r in range(3):
            x = poses[joint + 1, r, 3] - poses[0, r, 3]
            for k in range(3):
                x += poses[joint + 1, r, k] * corners[v, k]
            away += x * x
        far = max(far, away)
    return float(table.deviates[solid] + error[0] + error[1] * np.sqrt(far))


@inner_kernel
def deviation_bound(
    table: HullTable, solid: int, travel: Array, lateral: Array, poses: Array
) -> tuple[float, float, float]:
    """Return a bound on how far any point of a body deviates from straight lines on a motion.

    Args:
        table: the bodies.
        solid: the body.
        travel: how far each joint goes, none of them further than half of it from ``poses``,
            shape (n,).
        lateral: by how much each joint is from a straight line at most, shape (n,).
        poses: joint poses in the middle.

    Returns:
        First from its place in the middle: the argument of planning.geometry.swept. Second,
        on a straight joint-space motion, from the straight line between its places at the
        ends: an eighth of its largest second derivative, to which each pair of joints adds the
        product of their travels times the point's distance from the axis of the one nearer to
        the tip. Third from where it is on the straight joint-space motion.
    """
    ends, radius = table.ends, table.radius
    first, last = table.capsule_first[solid], table.capsule_first[solid + 1]
    prismatic = table.robot.prismatic
    joint = table.joint[solid]
    still = True
    for j in range(joint + 1):
        still = still and travel[j] == 0.0 and lateral[j] == 0.0
    if still:
        return 0.0, 0.0, 0.0
    count = last - first
    points = stack_rows(_STACK_POINTS, 4)
    if 2 * count > _STACK_POINTS:
        points = np.empty((2 * count, 4))
    for c in range(count):
        for e in range(2):
            x, y, z = (
                ends[first + c, e, 0],
                ends[first + c, e, 1],
                ends[first + c, e, 2],
            )
            for r in range(3):
                m = poses[joint + 1, r, 0] * x + poses[joint + 1, r, 1] * y
                m += poses[joint + 1, r, 2] * z
                points[2 * c + e, r] = m + poses[joint + 1, r, 3]
            points[2 * c + e, 3] = radius[first + c]
    moved = bend = off = 0.0
    for j in range(joint, -1, -1):
        if travel[j] == 0.0 and lateral[j] == 0.0:
            continue
        turned = 0.0
        for i in range(j):
            if not prismatic[i]:
                turned += travel[i]
        if prismatic[j]:
            moved += 0.5 * travel[j]
            bend += 2.0 * travel[j] * turned
            off += lateral[j]
            continue
        frame = poses[j + 1]
        ax, ay, az = joint_axis(table.robot, poses, j)
        reach = 0.0
        for i in range(2 * count):
            x = points[i, 0] - frame[0, 3]
            y = points[i, 1] - frame[1, 3]
            z = points[i, 2] - frame[2, 3]
            cx, cy, cz = y * az - z * ay, z * ax - x * az, x * ay - y * ax
            far = np.sqrt(cx * cx + cy * cy + cz * cz) + points[i, 3]
            reach = max(reach, far)
        reach += moved
        moved += 0.5 * travel[j] * reach
        bend += travel[j] * (travel[j] + 2.0 * turned) * reach
        off += lateral[j] * reach
    return moved, 0.125 * bend, off
