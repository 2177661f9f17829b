"""Separating planes of moving convex hulls, in compiled code: a fast proof that replaces most exact checks."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planning.geometry.deviation_bounds import (
    deviation_bound,
    deviation_bound_with_base,
)
from planning.geometry.exact import TOLERANCE
from planning.geometry.gjk import BETWEEN, CLOSE, FAR, TOO_CLOSE, classify_gap
from planning.geometry.hull_table import AT_REST, HullTable, place_corners
from planning.kernels import ZERO, inner_kernel
from planning.kinematics.chain import pose_joints
from planning.packed import packed
from planning.transforms import Array, Indices

APART, UNDECIDED, CONFLICT = 1, 0, -1
"""Answers of ``check_hulls_continuously``."""

_FROM, _TO, _TRAVEL, _MIDDLE, _STRAIGHT = range(5)
"""Rows of ``joints_a`` and ``joints_b``."""


class Scratch(NamedTuple):
    """Work arrays for one stretch of two occupancies.

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
    """Return work arrays for the bodies of two occupancies."""
    joints = a.q_a.shape[1], b.q_a.shape[1]
    return make_scratch_for(*joints, a.most_corners, b.most_corners)


def make_scratch_for(n: int, m: int, a_corners: int, b_corners: int) -> Scratch:
    """Return work arrays for two occupancies.

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
    """Prepare two segments for ``check_hulls_continuously``."""
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
def check_hulls_continuously(
    a: HullTable, i: int, b: HullTable, j: int, clearance: float, scratch: Scratch
) -> int:
    """Tell whether two bodies are proved to keep a clearance, each anywhere on its motion.

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
        a_moved, a_bend, _ = deviation_bound(
            a, x, joints_a[_TRAVEL], joints_a[_STRAIGHT], poses_a
        )
        b_moved, b_bend, _ = deviation_bound(
            b, y, joints_b[_TRAVEL], joints_b[_STRAIGHT], poses_b
        )
        close = clearance + deviation_bound_with_base(a, x, poses_a)
        close += deviation_bound_with_base(b, y, poses_b)
        # What moves away from its base strays further with it.
        outward = a.robot.error[1] * a_moved + b.robot.error[1] * b_moved
        gap = classify_gap(
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
        gap = classify_gap(
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
    """Write a body's corners at both ends of a motion; return their number."""
    if table.joint[solid] == AT_REST:
        return place_corners(table, solid, poses, out, ZERO)
    _pose_at(table, joints[_FROM], poses)
    count = place_corners(table, solid, poses, out, ZERO)
    _pose_at(table, joints[_TO], poses)
    return place_corners(table, solid, poses, out, count)
