"""Separating planes of moving convex hulls, compiled: spares the exact decision what is apart.

Tables of moving convex bodies for compiled code, and how far they stray on a motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from planning.geometry.distance import BETWEEN, CLOSE, FAR, TOO_CLOSE, gap_class
from planning.geometry.exact import TOLERANCE, Solid
from planning.kernels import ZERO, inner_kernel
from planning.kinematics.chain import NO_JOINTS, JointTable, joint_axis, pose_joints
from planning.packed import packed, stack_rows
from planning.transforms import Array, Indices

APART, UNDECIDED, CONFLICT = 1, 0, -1
"""Answers of ``judge_hulls``."""

_FEW = 32
"""Ends of the capsules that nearly no body has more of."""

_FROM, _TO, _TRAVEL, _MIDDLE, _STRAIGHT = range(5)
"""Rows of ``joints_a`` and ``joints_b``."""


class Scratch(NamedTuple):
    """Room to work in.

    Attributes:
        whole_a, whole_b: joint poses at the middle of whole segments, shape (n + 1, 4, 4).
        part_a, part_b: joint poses elsewhere.
        corners_a, corners_b: shape (twice the most corners of a solid, 3).
        stack: parts still to be looked at, shape (64, 4).
        posed: the segments that ``whole_a`` and ``whole_b`` belong to, shape (2,).
        where: shares of both motions at which two bodies were not proved apart, shape (2,).
        joints_a, joints_b: of a stretch of a motion: both ends, how far each joint goes, the
            middle, and how far joints leave the straight line: zeros, shape (5, at least n).
        direction: in which two hulls were apart last: the first guess, shape (3,).
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
    joints_a: Array
    joints_b: Array
    direction: Array


def make_scratch(a: HullTable, b: HullTable) -> Scratch:
    """Return room for the bodies of two occupancies."""
    joints = a.q_a.shape[1], b.q_a.shape[1]
    return room_for(*joints, a.most_corners, b.most_corners)


def room_for(n: int, m: int, a_corners: int, b_corners: int) -> Scratch:
    """Return room for two occupancies.

    Args:
        n, m: joints of either.
        a_corners, b_corners: most corners of a solid of either.
    """
    scratch = Scratch(
        np.empty((n + 1, 4, 4)),
        np.empty((m + 1, 4, 4)),
        np.empty((n + 1, 4, 4)),
        np.empty((m + 1, 4, 4)),
        np.empty((2 * a_corners, 3)),
        np.empty((2 * b_corners, 3)),
        np.empty((64, 4)),
        np.full(2, -1, dtype=np.int64),
        np.empty(2),
        np.zeros((5, n)),
        np.zeros((5, m)),
        np.zeros(3),
    )
    return packed(scratch)


@inner_kernel
def pose_segments(a: HullTable, s: int, b: HullTable, t: int, scratch: Scratch) -> None:
    """Prepare two segments for ``judge_hulls``."""
    if scratch.posed[0] != s:
        _pose_middle(a, s, scratch.joints_a, scratch.whole_a)
        scratch.posed[0] = s
    if scratch.posed[1] != t:
        _pose_middle(b, t, scratch.joints_b, scratch.whole_b)
        scratch.posed[1] = t


@inner_kernel
def _pose_middle(table: HullTable, s: int, joints: Array, poses: Array) -> None:
    for j in range(table.q_a.shape[1]):
        joints[_MIDDLE, j] = 0.5 * (table.q_a[s, j] + table.q_b[s, j])
    _pose_at(table, joints[_MIDDLE], poses)


@inner_kernel
def _stretch(table: HullTable, s: int, lo: float, hi: float, joints: Array) -> None:
    """Write the joints of a stretch of a segment; see Scratch."""
    q_a, q_b = table.q_a, table.q_b
    for j in range(q_a.shape[1]):
        step = q_b[s, j] - q_a[s, j]
        joints[_FROM, j] = q_a[s, j] + lo * step
        joints[_TO, j] = q_a[s, j] + hi * step
        joints[_TRAVEL, j] = (hi - lo) * abs(step)
        joints[_MIDDLE, j] = 0.5 * (joints[_FROM, j] + joints[_TO, j])


@inner_kernel
def _pose_at(table: HullTable, q: Array, poses: Array) -> None:
    pose_joints(table.robot, q[: table.q_a.shape[1]], poses)


@inner_kernel
def judge_hulls(
    a: HullTable, i: int, b: HullTable, j: int, clearance: float, scratch: Scratch
) -> int:
    """Tell whether two bodies keep a clearance, each anywhere on its motion, as far as proved.

    Args:
        a, i: an occupancy, and a body of it.
        b, j: likewise for the other.
        clearance: least distance, wherever bases are that may be off [m]; where negative, 0 is
            proved or nothing.
        scratch: after ``pose_segments``; where the answer is not APART, ``where`` says where
            they come close.

    Returns:
        APART when they keep it, CONFLICT when somewhere they do not, or come within TOLERANCE
        of it, UNDECIDED when neither is proved.
    """
    s, t = scratch.posed[0], scratch.posed[1]
    x, y = ZERO + a.solid[s, i], ZERO + b.solid[t, j]
    corners_a, corners_b, stack = scratch.corners_a, scratch.corners_b, scratch.stack
    joints_a, joints_b = scratch.joints_a, scratch.joints_b
    stack[0, 0] = stack[0, 2] = 0.0
    stack[0, 1] = stack[0, 3] = 1.0
    depth = 1
    while depth > 0:
        depth -= 1
        a0, a1, b0, b1 = stack[depth]
        _stretch(a, s, a0, a1, joints_a)
        _stretch(b, t, b0, b1, joints_b)
        poses_a, poses_b = scratch.whole_a, scratch.whole_b
        if a1 - a0 < 1.0:
            poses_a = scratch.part_a
            _pose_at(a, joints_a[_MIDDLE], poses_a)
        if b1 - b0 < 1.0:
            poses_b = scratch.part_b
            _pose_at(b, joints_b[_MIDDLE], poses_b)
        a_moved, a_bend, _ = stray(
            a, x, joints_a[_TRAVEL], joints_a[_STRAIGHT], poses_a
        )
        b_moved, b_bend, _ = stray(
            b, y, joints_b[_TRAVEL], joints_b[_STRAIGHT], poses_b
        )
        close = clearance + strays_with_base(a, x, poses_a)
        close += strays_with_base(b, y, poses_b)
        # What moves away from its base strays further with it.
        outward = a.robot.error[1] * a_moved + b.robot.error[1] * b_moved
        gap = gap_class(
            corners_a,
            place_corners(a, x, poses_a, corners_a, ZERO),
            corners_b,
            place_corners(b, y, poses_b, corners_b, ZERO),
            close,
            close + a_moved + b_moved + outward,
            scratch.direction,
        )
        if gap == FAR:
            continue
        fine = a_moved + b_moved < TOLERANCE
        if gap <= CLOSE or fine or depth + 2 > len(stack):
            scratch.where[0], scratch.where[1] = 0.5 * (a0 + a1), 0.5 * (b0 + b1)
            proved = gap == TOO_CLOSE or (fine and gap == BETWEEN)
            return CONFLICT if proved else UNDECIDED
        # The hull of a body's places at both ends holds all in between, but for the bend.
        a_count = _place_ends(a, x, joints_a, scratch.part_a, corners_a)
        b_count = _place_ends(b, y, joints_b, scratch.part_b, corners_b)
        enough = close + a_bend + b_bend + outward
        gap = gap_class(
            corners_a, a_count, corners_b, b_count, enough, enough, scratch.direction
        )
        if gap == FAR:
            continue
        for k in range(2):
            for c in range(4):
                stack[depth + k, c] = (a0, a1, b0, b1)[c]
        if a_moved >= b_moved:
            stack[depth, 1] = stack[depth + 1, 0] = 0.5 * (a0 + a1)
        else:
            stack[depth, 3] = stack[depth + 1, 2] = 0.5 * (b0 + b1)
        depth += 2
    return APART


@inner_kernel
def _place_ends(
    table: HullTable, solid: int, joints: Array, poses: Array, out: Array
) -> int:
    """Write a body's corners at both ends of a motion; return how many there are."""
    if table.joint[solid] == AT_REST:
        return place_corners(table, solid, poses, out, ZERO)
    _pose_at(table, joints[_FROM], poses)
    count = place_corners(table, solid, poses, out, ZERO)
    _pose_at(table, joints[_TO], poses)
    return place_corners(table, solid, poses, out, count)


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
        most_corners: most corners of a solid.
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
    most_corners: int

    def on_a_motion(self) -> HullTable:
        """Return the same bodies on one segment of its own."""
        n = self.q_a.shape[1]
        return packed(self._replace(q_a=np.zeros((1, n)), q_b=np.zeros((1, n))))

    def seen_from_base(self) -> HullTable:
        """Return the same bodies as their own robot sees them: no error of its base parts them."""
        if not (self.robot.error.any() or self.deviates.any()):
            return packed(self)
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
        max(map(len, corners)),
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
    still = True
    for j in range(joint + 1):
        still = still and travel[j] == 0.0 and aside[j] == 0.0
    if still:
        return 0.0, 0.0, 0.0
    count = last - first
    points = stack_rows(_FEW, 4)
    if 2 * count > _FEW:
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
