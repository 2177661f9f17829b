"""Tables of moving convex bodies for compiled code, and how far they stray on a motion."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from planning.geometry.exact import Solid
from planning.kernels import inner_kernel
from planning.kinematics.chain import NO_JOINTS, JointTable, joint_axis
from planning.packed import packed
from planning.transforms import Array, Indices

AT_REST = -2
"""Stands for the joint of a body that rests in the world."""


class HullTable(NamedTuple):
    """The bodies of an occupancy, for compiled code.

    Attributes:
        robot: joints of the robot.
        q_a, q_b: ends of the segments, shape (s, n).
        solid: index of the solid of every body of every segment, -1 for none, shape
            (s, bodies).
        joint: joint that carries a solid, -1 for the base, AT_REST for none, shape (solids,).
        corner_first: where the corners of a solid begin, shape (solids + 1,).
        corners: hull corners in the joint's frame, or in the world, shape (all, 3) [m].
        capsule_first: where the capsules of a solid begin, shape (solids + 1,).
        ends: capsule starts and ends in the same frame, shape (capsules, 2, 3) [m].
        radius: capsule radii, shape (capsules,) [m].
        deviates: how far any point of a solid may be from where joints have it, shape (solids,) [m].
    """

    robot: JointTable
    q_a: Array
    q_b: Array
    solid: npt.NDArray[np.int32]
    joint: Indices
    corner_first: Indices
    corners: Array
    capsule_first: Indices
    ends: Array
    radius: Array
    deviates: Array

    @property
    def most_corners(self) -> int:
        """Most corners of a solid."""
        return int(np.max(np.diff(self.corner_first), initial=0))

    def on_a_motion(self) -> HullTable:
        """Return the same bodies on one segment of its own."""
        n = self.q_a.shape[1]
        return packed(self._replace(q_a=np.zeros((1, n)), q_b=np.zeros((1, n))))

    def seen_from_base(self) -> HullTable:
        """Return the same bodies as their own robot sees them: no error of its base parts them."""
        robot = packed(self.robot._replace(error=np.zeros(2)))
        none = np.zeros_like(self.deviates)
        return packed(self._replace(robot=robot, deviates=none))


def hull_table(
    robot: JointTable,
    q_a: Array,
    q_b: Array,
    solid: npt.NDArray[np.int32],
    solids: Sequence[Solid],
) -> HullTable:
    """Collect bodies for compiled code.

    Args:
        robot: joints of the robot that carries them.
        q_a, q_b: ends of the segments, shape (s, n).
        solid: index of the solid of every body of every segment, shape (s, bodies).
        solids: the bodies.
    """
    # There may be no bodies at all: a robot alone in an empty cell.
    corners = [np.empty((0, 3)), *(s.vertices for s in solids)]
    ends = [np.empty((0, 2, 3)), *(s.ends for s in solids)]
    radius = [np.empty(0), *(s.body.capsules.radius for s in solids)]
    joint = [AT_REST if s.carrier is None else s.joint for s in solids]
    table = HullTable(
        robot,
        q_a,
        q_b,
        solid,
        np.array(joint, dtype=np.int64),
        np.cumsum([len(c) for c in corners]).astype(np.int64),
        np.concatenate(corners),
        np.cumsum([len(e) for e in ends]).astype(np.int64),
        np.concatenate(ends),
        np.concatenate(radius),
        np.array([s.deviates for s in solids], dtype=np.float64),
    )
    return packed(table)


def standing_hulls(solids: Sequence[Solid]) -> HullTable:
    """Collect bodies that rest in the world."""
    q, which = np.empty((1, 0)), np.arange(len(solids), dtype=np.int32)[None]
    return hull_table(NO_JOINTS, q, q, which, solids)


@inner_kernel
def place_corners(
    table: HullTable, solid: int, poses: Array, out: Array, offset: int
) -> int:
    """Write the corners of a body in the world from row ``offset`` on; return where they end."""
    first, last = table.corner_first[solid], table.corner_first[solid + 1]
    corners, p = table.corners, table.joint[solid] + 1
    end = offset + last - first
    if p <= AT_REST + 1:
        for v in range(first, last):
            for r in range(3):
                out[offset + v - first, r] = corners[v, r]
        return int(end)
    for v in range(first, last):
        x, y, z = corners[v, 0], corners[v, 1], corners[v, 2]
        for r in range(3):
            out[offset + v - first, r] = (
                poses[p, r, 0] * x
                + poses[p, r, 1] * y
                + poses[p, r, 2] * z
                + poses[p, r, 3]
            )
    return int(end)


@inner_kernel
def strays_with_base(table: HullTable, solid: int, poses: Array) -> float:
    """Return how far an error of its robot's base, and what it deviates, takes any point of a body, at most [m].

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
def stray(
    table: HullTable, solid: int, travel: Array, aside: Array, poses: Array
) -> tuple[float, float, float]:
    """Return how far any point of a body strays on a motion, at most.

    Args:
        table: the bodies.
        solid: the body.
        travel: how far each joint goes, none of them further than half of it from ``poses``,
            shape (n,).
        aside: how far each joint is from a straight line at most, shape (n,).
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
    if joint == AT_REST:
        return 0.0, 0.0, 0.0
    count = last - first
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
        if travel[j] == 0.0 and aside[j] == 0.0:
            continue
        turned = 0.0
        for i in range(j):
            if not prismatic[i]:
                turned += travel[i]
        if prismatic[j]:
            moved += 0.5 * travel[j]
            bend += 2.0 * travel[j] * turned
            off += aside[j]
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
        off += aside[j] * reach
    return moved, 0.125 * bend, off
