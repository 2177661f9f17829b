"""Separating planes of long pieces of motion, in compiled code: one test for many path segments.

A *stretch* is a sequence of segments of a path. Two bounds on the positions of its bodies are computed: from the
ranges of its joint values, and from their deviation from the straight line between its ends. If neither bound proves
two bodies apart, shorter stretches are tested, down to single segments (``planning.geometry.separation``).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planning.geometry.deviation_bounds import (
    deviation_bound,
    deviation_bound_with_base,
)
from planning.geometry.gjk import BETWEEN, FAR, classify_gap
from planning.geometry.hull_table import AT_REST, HullTable, place_corners
from planning.kernels import ZERO, inner_kernel
from planning.kinematics.chain import pose_joints
from planning.packed import packed
from planning.transforms import Array, Indices

MIXED = -2
"""Placeholder for the solid of a body that is not the same on all of a stretch."""


class PosedStretch(NamedTuple):
    """Joint poses of a stretch: of a sequence of segments of an occupancy.

    Attributes:
        span: its segments, ``range(first, last)``, how many stretches were posed, and how many
            directions measured, shape (4,).
        half: joint values in the middle of the box, shape (n,).
        travel: difference of greatest and least joint values, shape (n,).
        lateral: by how much each joint is from the straight line at most, shape (n,).
        middle, start, end: joint poses in the middle of the box and at both ends, shape
            (n + 1, 4, 4).
        strays: see ``stray``; the first two with what an error of the base adds, shape
            (solids, 3).
        known: the stretch for which ``strays`` was measured, shape (solids,).
        solid: solid of each body, -1 for none, MIXED where not the same all along, shape
            (bodies,).
        least: lower bound of each body's extent along a direction, shape (bodies,) [m].
        measured: for which direction ``least`` was measured, shape (bodies,).
        corners: shape (twice the most corners of a solid, 3).
        ends, radius: swept capsules, as in HullTable, in the world.
        swept: for which stretch a body's capsules were swept, shape (solids,).
    """

    span: Indices
    half: Array
    travel: Array
    lateral: Array
    middle: Array
    start: Array
    end: Array
    strays: Array
    known: Indices
    solid: Indices
    least: Array
    measured: Indices
    corners: Array
    ends: Array
    radius: Array
    swept: Indices


def make_stretch(table: HullTable) -> PosedStretch:
    """Return work arrays for a stretch of an occupancy."""
    n, solids, bodies = table.q_a.shape[1], len(table.joint), table.solid.shape[1]
    stretch = PosedStretch(
        np.zeros(4, dtype=np.int64),
        np.empty(n),
        np.empty(n),
        np.empty(n),
        np.empty((n + 1, 4, 4)),
        np.empty((n + 1, 4, 4)),
        np.empty((n + 1, 4, 4)),
        np.empty((solids, 3)),
        np.zeros(solids, dtype=np.int64),
        np.empty(bodies, dtype=np.int64),
        np.empty(bodies),
        np.zeros(bodies, dtype=np.int64),
        np.empty((2 * table.most_corners, 3)),
        np.empty(table.ends.shape),
        np.empty(table.radius.shape),
        np.zeros(solids, dtype=np.int64),
    )
    return packed(stretch)


@inner_kernel
def _pose_box(table: HullTable, first: int, last: int, out: PosedStretch) -> None:
    """Write the joint-value box of some segments and the poses at its middle."""
    n = len(out.half)
    out.span[0], out.span[1] = first, last
    out.span[2] += 1
    for j in range(n):
        low = high = table.q_a[first, j]
        for s in range(first, last):
            a, b = table.q_a[s, j], table.q_b[s, j]
            low, high = min(low, a, b), max(high, a, b)
        out.half[j], out.travel[j] = 0.5 * (low + high), high - low
        out.lateral[j] = 0.0
    pose_joints(table.robot, out.half, out.middle)
    for i in range(len(out.solid)):
        solid = int(table.solid[first, i])
        for s in range(first + 1, last):
            if table.solid[s, i] != solid:
                solid = MIXED
                break
        out.solid[i] = solid


@inner_kernel
def pose_stretch(table: HullTable, first: int, last: int, out: PosedStretch) -> None:
    """Prepare a stretch for ``are_stretches_apart``, unless it is the one posed last."""
    if out.span[0] == first and out.span[1] == last:
        return
    _pose_box(table, first, last, out)
    q_a, q_b = table.q_a[first], table.q_b[last - 1]
    pose_joints(table.robot, q_a, out.start)
    pose_joints(table.robot, q_b, out.end)
    n = len(out.half)
    length = 0.0
    for j in range(n):
        length += (q_b[j] - q_a[j]) ** 2
    # Between its ends each segment deviates no more than at one of them.
    for s in range(first, last):
        for k in range(2):
            q = table.q_a[s] if k == 0 else table.q_b[s]
            share = 0.0
            if length > 0.0:
                for j in range(n):
                    share += (q[j] - q_a[j]) * (q_b[j] - q_a[j])
                share = min(max(share / length, 0.0), 1.0)
            for j in range(n):
                off = abs(q[j] - q_a[j] - share * (q_b[j] - q_a[j]))
                out.lateral[j] = max(out.lateral[j], off)


@inner_kernel
def measure_deviation(table: HullTable, solid: int, stretch: PosedStretch) -> None:
    """Write a bound on the deviation of a body on a stretch, unless it is known."""
    if stretch.known[solid] == stretch.span[2]:
        return
    stretch.known[solid] = stretch.span[2]
    strays = stretch.strays
    strays[solid, 0], strays[solid, 1], strays[solid, 2] = deviation_bound(
        table, solid, stretch.travel, stretch.lateral, stretch.middle
    )
    off = deviation_bound_with_base(table, solid, stretch.middle)
    if off > 0.0:
        off += table.robot.error[1] * strays[solid, 0]
        strays[solid, 0] += off
        strays[solid, 1] += off


@inner_kernel
def are_stretches_apart(
    a: HullTable,
    x: int,
    on_a: PosedStretch,
    b: HullTable,
    y: int,
    on_b: PosedStretch,
    clearance: float,
    direction: Array,
) -> bool:
    """Tell whether two bodies are proved to keep a clearance, each anywhere on its stretch.

    Args:
        a, x, on_a: an occupancy, a solid of it, and the stretch, posed.
        b, y, on_b: likewise for the other.
        clearance: least distance [m]; where negative, 0 is proved or nothing.
        direction: where the answer is True, that of the separating planes, shape (3,).
    """
    corners_a, corners_b = on_a.corners, on_b.corners
    strays_a, strays_b = on_a.strays, on_b.strays
    gap = classify_gap(
        corners_a,
        place_corners(a, x, on_a.middle, corners_a, ZERO),
        corners_b,
        place_corners(b, y, on_b.middle, corners_b, ZERO),
        clearance,
        clearance + strays_a[x, 0] + strays_b[y, 0],
        direction,
    )
    if gap != BETWEEN:
        return bool(gap == FAR)
    count_a = place_corners(a, x, on_a.start, corners_a, ZERO)
    count_b = place_corners(b, y, on_b.start, corners_b, ZERO)
    enough = clearance + strays_a[x, 1] + strays_a[x, 2]
    enough += strays_b[y, 1] + strays_b[y, 2]
    gap = classify_gap(
        corners_a,
        place_corners(a, x, on_a.end, corners_a, count_a),
        corners_b,
        place_corners(b, y, on_b.end, corners_b, count_b),
        enough,
        enough,
        direction,
    )
    return bool(gap == FAR)


@inner_kernel
def measure_bodies(
    table: HullTable, stretch: PosedStretch, direction: Array, sign: float
) -> None:
    """Write lower bounds of extents along ``sign * direction`` on a stretch.

    Of the bodies whose ``measured`` is the negative of the direction's number: one call for
    many of them, as every call with so many arrays has its price.
    """
    corners, corner_first, joints = table.corners, table.corner_first, table.joint
    start, middle, end = stretch.start, stretch.middle, stretch.end
    measured, solids, least = stretch.measured, stretch.solid, stretch.least
    strays, number = stretch.strays, stretch.span[3]
    x, y, z = sign * direction[0], sign * direction[1], sign * direction[2]
    for body in range(len(measured)):
        if measured[body] != -number:
            continue
        measured[body] = number
        solid = solids[body]
        first, last = corner_first[solid], corner_first[solid + 1]
        joint = joints[solid]
        if joint == AT_REST:
            least[body] = _least(corners, first, last, x, y, z)
            continue
        from_ends = np.inf
        for k in range(2):
            poses = start if k == 0 else end
            from_ends = min(
                from_ends, _extent(corners, first, last, poses, joint + 1, x, y, z)
            )
        from_middle = _extent(corners, first, last, middle, joint + 1, x, y, z)
        least[body] = max(
            from_ends - strays[solid, 1] - strays[solid, 2],
            from_middle - strays[solid, 0],
        )


@inner_kernel
def _extent(
    corners: Array,
    first: int,
    last: int,
    poses: Array,
    p: int,
    x: float,
    y: float,
    z: float,
) -> float:
    at = x * poses[p, 0, 3] + y * poses[p, 1, 3] + z * poses[p, 2, 3]
    return float(
        at
        + _least(
            corners,
            first,
            last,
            x * poses[p, 0, 0] + y * poses[p, 1, 0] + z * poses[p, 2, 0],
            x * poses[p, 0, 1] + y * poses[p, 1, 1] + z * poses[p, 2, 1],
            x * poses[p, 0, 2] + y * poses[p, 1, 2] + z * poses[p, 2, 2],
        )
    )


@inner_kernel
def _least(
    corners: Array, first: int, last: int, x: float, y: float, z: float
) -> float:
    least = np.inf
    for v in range(first, last):
        along = x * corners[v, 0] + y * corners[v, 1] + z * corners[v, 2]
        if along < least:
            least = along
    return least


@inner_kernel
def sweep_all_capsules(table: HullTable, stretch: PosedStretch) -> None:
    """Write the capsules of all bodies that are the same throughout a posed stretch."""
    for solid in stretch.solid:
        if solid >= 0:
            measure_deviation(table, solid, stretch)
            sweep_capsules(table, solid, stretch)


@inner_kernel
def sweep_capsules(table: HullTable, solid: int, stretch: PosedStretch) -> None:
    """Write the capsules that contain a body on a stretch, posed and measured.

    The ends of a capsule stay as near to where they are in the middle as any point does, and
    as near as they are at both ends of the stretch, but for the bend in between.
    """
    posed = stretch.span[2]
    if stretch.swept[solid] == posed:
        return
    stretch.swept[solid] = posed
    ends, radius, p = table.ends, table.radius, table.joint[solid] + 1
    start, middle, end = stretch.start, stretch.middle, stretch.end
    strays, out, grown = stretch.strays, stretch.ends, stretch.radius
    for c in range(table.capsule_first[solid], table.capsule_first[solid + 1]):
        grown[c] = radius[c]
        if p < 0:
            for k in range(2):
                for r in range(3):
                    out[c, k, r] = ends[c, k, r]
            continue
        off = 0.0
        for k in range(2):
            x, y, z = ends[c, k, 0], ends[c, k, 1], ends[c, k, 2]
            from_start = from_end = 0.0
            for r in range(3):
                m = middle[p, r, 0] * x + middle[p, r, 1] * y
                m += middle[p, r, 2] * z + middle[p, r, 3]
                out[c, k, r] = m
                if p == 0:
                    continue  # the base stands
                n = start[p, r, 0] * x + start[p, r, 1] * y
                n += start[p, r, 2] * z + start[p, r, 3]
                from_start += (m - n) * (m - n)
                n = end[p, r, 0] * x + end[p, r, 1] * y
                n += end[p, r, 2] * z + end[p, r, 3]
                from_end += (m - n) * (m - n)
            off = max(off, from_start, from_end)
        near = np.sqrt(off) + strays[solid, 1] + strays[solid, 2]
        grown[c] += min(strays[solid, 0], near)
