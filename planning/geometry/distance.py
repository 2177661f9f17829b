"""Distances of segments and boxes, in compiled code."""

from __future__ import annotations

from planning.kernels import inner_kernel
from planning.packed import stack_rows
from planning.transforms import Array

Vector = tuple[float, float, float]


@inner_kernel
def segment_segment(a0: Array, a1: Array, b0: Array, b1: Array) -> float:
    """Return the squared distance [m^2] of segments a0-a1 and b0-b1, each end of shape (3,)."""
    return segment_distance(
        (a1[0] - a0[0], a1[1] - a0[1], a1[2] - a0[2]),
        (b1[0] - b0[0], b1[1] - b0[1], b1[2] - b0[2]),
        (a0[0] - b0[0], a0[1] - b0[1], a0[2] - b0[2]),
    )


@inner_kernel
def segment_distance(u: Vector, v: Vector, w: Vector) -> float:
    """Return the squared distance [m^2] of segments w + [0, 1] u and [0, 1] v."""
    ux, uy, uz = u
    vx, vy, vz = v
    wx, wy, wz = w
    a = ux * ux + uy * uy + uz * uz
    c = vx * vx + vy * vy + vz * vz
    b = ux * vx + uy * vy + uz * vz
    d = ux * wx + uy * wy + uz * wz
    e = vx * wx + vy * wy + vz * wz
    tiny = 1e-16
    if a <= tiny:
        s = 0.0
        t = 0.0 if c <= tiny else min(max(e / c, 0.0), 1.0)
    elif c <= tiny:
        t = 0.0
        s = min(max(-d / a, 0.0), 1.0)
    else:
        det = a * c - b * b
        s = 0.0
        if det > 1e-12 * a * c:
            s = min(max((b * e - c * d) / det, 0.0), 1.0)
        t = (b * s + e) / c
        # Where the line's nearest point is off the segment, clamp it and solve for s again.
        if t < 0.0:
            t = 0.0
            s = min(max(-d / a, 0.0), 1.0)
        elif t > 1.0:
            t = 1.0
            s = min(max((b - d) / a, 0.0), 1.0)
    dx = wx + s * ux - t * vx
    dy = wy + s * uy - t * vy
    dz = wz + s * uz - t * vz
    return float(dx * dx + dy * dy + dz * dz)


@inner_kernel
def _seen_from_box(p0: Array, p1: Array, pose: Array, line: Array) -> None:
    """Write the start and the vector of a segment in the frame of a box, shape (3, 2)."""
    for r in range(3):
        x0 = y0 = 0.0
        for c in range(3):
            x0 += pose[c, r] * (p0[c] - pose[c, 3])
            y0 += pose[c, r] * (p1[c] - p0[c])
        line[r, 0] = x0
        line[r, 1] = y0


@inner_kernel
def is_segment_near_box(
    p0: Array, p1: Array, pose: Array, half: Array, near: float
) -> bool:
    """Tell whether a segment comes within a distance [m] of a solid box; see segment_box."""
    line = stack_rows(3, 2)
    _seen_from_box(p0, p1, pose, line)
    # Most are beyond one of the faces.
    for r in range(3):
        begin, end = line[r, 0], line[r, 0] + line[r, 1]
        if max(begin, end) < -half[r] - near or min(begin, end) > half[r] + near:
            return False
    return bool(_squared_gap(line, half) <= near * near)


@inner_kernel
def segment_box(p0: Array, p1: Array, pose: Array, half: Array) -> float:
    """Return the squared distance [m^2] of a segment and a solid box.

    Args:
        p0, p1: segment ends in the world, shape (3,).
        pose: of the box centre, shape (4, 4).
        half: half edge lengths, shape (3,).
    """
    line = stack_rows(3, 2)
    _seen_from_box(p0, p1, pose, line)
    return _squared_gap(line, half)


@inner_kernel
def _squared_gap(line: Array, half: Array) -> float:
    """Return the squared distance of a box and a segment in the frame of that box.

    The distance to a box is convex along the segment and its derivative is linear between the
    parameters at which the segment crosses a face plane: bracket the zero among those.
    """
    lo, hi = 0.0, 1.0
    if _slope(line, half, lo) >= 0.0:
        return _outside(line, half, lo)
    if _slope(line, half, hi) <= 0.0:
        return _outside(line, half, hi)
    for r in range(3):
        if abs(line[r, 1]) > 1e-12:
            for side in (-1.0, 1.0):
                t = (side * half[r] - line[r, 0]) / line[r, 1]
                if lo < t < hi:
                    if _slope(line, half, t) >= 0.0:
                        hi = t
                    else:
                        lo = t
    s_lo, s_hi = _slope(line, half, lo), _slope(line, half, hi)
    t = lo if s_hi <= s_lo else lo + (hi - lo) * (-s_lo) / (s_hi - s_lo)
    return _outside(line, half, t)


@inner_kernel
def _slope(line: Array, half: Array, t: float) -> float:
    total = 0.0
    for r in range(3):
        x = line[r, 0] + t * line[r, 1]
        if x > half[r]:
            total += line[r, 1] * (x - half[r])
        elif x < -half[r]:
            total += line[r, 1] * (x + half[r])
    return total


@inner_kernel
def _outside(line: Array, half: Array, t: float) -> float:
    total = 0.0
    for r in range(3):
        over = abs(line[r, 0] + t * line[r, 1]) - half[r]
        if over > 0.0:
            total += over * over
    return total


@inner_kernel
def are_boxes_apart(a: Array, i: int, b: Array, j: int, gap: float) -> bool:
    """Tell whether two axis-aligned boxes are further apart than a gap.

    Args:
        a, i: least and greatest corners of boxes, shape (.., 6) [m], and one of them.
        b, j: likewise for the other.
        gap: the gap [m].
    """
    for r in range(3):
        if a[i, r] - b[j, r + 3] > gap or b[j, r] - a[i, r + 3] > gap:
            return True
    return False
