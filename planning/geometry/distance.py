"""Distances of segments, boxes and convex hulls (GJK), compiled."""

from __future__ import annotations

import numpy as np

from planning.kernels import inner_kernel
from planning.packed import stack_rows
from planning.transforms import Array

Vector = tuple[float, float, float]

FAR, BETWEEN, CLOSE, TOO_CLOSE = 1, 0, -1, -2
"""Classification of two hulls, see ``classify_gap``."""

_STEPS = 24
ROUNDING = 1e-9
"""Added to every distance that must be proved [m]."""

_CERTAIN = 1e-7
"""Margin by which hulls must be too close, or overlap, to count as certain [m]."""

_FLAT = 1e-22
"""Squared height of a tetrahedron against its edges from which on rounding decides its sides."""

_SLIVER = 1e-10
"""Faces of a smaller area have no reliable side [m^2]."""


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


@inner_kernel
def _support(corners: Array, count: int, x: float, y: float, z: float) -> int:
    best, at = -np.inf, 0
    for v in range(count):
        d = x * corners[v, 0] + y * corners[v, 1] + z * corners[v, 2]
        if d > best:
            best, at = d, v
    return at


@inner_kernel
def classify_gap(
    a: Array,
    a_count: int,
    b: Array,
    b_count: int,
    clearance: float,
    enough: float,
    direction: Array,
) -> int:
    """Classify the distance of two hulls.

    Args:
        a, a_count: corners of the one hull, the first ``a_count`` rows of shape (.., 3).
        b, b_count: likewise for the other.
        clearance: below this they are too close [m]; where not positive, when they overlap.
        enough: from this on they are far enough, at least ``clearance`` [m].
        direction: to begin with, from b to a, zeros where there is no guess; what separates
            them, of length 1, is written here where they are FAR or BETWEEN, shape (3,).

    Returns:
        FAR when they are proved to be at least ``enough`` apart, TOO_CLOSE when they are proved
        to overlap or to be closer than ``clearance``, BETWEEN when both are proved wrong, CLOSE
        when nothing is proved.
    """
    near = max(clearance, 0.0) + ROUNDING
    far = max(enough, 0.0) + ROUNDING
    simplex = stack_rows(4, 3)
    size = 0
    lower, norm = -1.0, np.inf
    vx, vy, vz = direction[0], direction[1], direction[2]
    guess = vx**2 + vy**2 + vz**2
    if guess < 0.5:
        for i in range(a_count):
            vx += a[i, 0] / a_count
            vy += a[i, 1] / a_count
            vz += a[i, 2] / a_count
        for j in range(b_count):
            vx -= b[j, 0] / b_count
            vy -= b[j, 1] / b_count
            vz -= b[j, 2] / b_count
    for _ in range(_STEPS):
        norm = np.sqrt(vx * vx + vy * vy + vz * vz)
        # From the second round on v is a point of the difference: its length bounds the gap.
        if norm < near and (size > 0 or guess < 0.5):
            if norm < clearance - _CERTAIN:
                return TOO_CLOSE
            break
        if lower >= near and size > 0 and norm < far:
            direction[0], direction[1], direction[2] = vx / norm, vy / norm, vz / norm
            return BETWEEN
        i = _support(a, a_count, -vx, -vy, -vz)
        j = _support(b, b_count, vx, vy, vz)
        w0, w1, w2 = a[i, 0] - b[j, 0], a[i, 1] - b[j, 1], a[i, 2] - b[j, 2]
        lower = max(lower, (vx * w0 + vy * w1 + vz * w2) / norm)
        if lower >= far:
            direction[0], direction[1], direction[2] = vx / norm, vy / norm, vz / norm
            return FAR
        again = False
        for s in range(size):
            if simplex[s, 0] == w0 and simplex[s, 1] == w1 and simplex[s, 2] == w2:
                again = True
        if again:
            break
        simplex[size, 0], simplex[size, 1], simplex[size, 2] = w0, w1, w2
        size, vx, vy, vz = _nearest(simplex, size + 1, vx, vy, vz)
        if size == 4:
            # With a negative limit, they may overlap a little.
            if clearance >= 0.0 and _well_inside(simplex):
                return TOO_CLOSE
            break
    return BETWEEN if lower >= near and norm < far else CLOSE


@inner_kernel
def _nearest(
    simplex: Array, size: int, vx: float, vy: float, vz: float
) -> tuple[int, float, float, float]:
    """Return the point of a simplex nearest to the origin, and the number of corners that span it.

    The corners that it needs come first afterwards; where the origin is inside all four stay,
    and the point is the one given. The newest corner is the last one. Every face, edge and
    corner is tried, and of those that hold the origin's projection the nearest wins: few
    operations, and no case to get wrong.
    """
    if size == 4 and _inside(simplex):
        return 4, vx, vy, vz
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
    vx, vy, vz = wi * simplex[ki, 0], wi * simplex[ki, 1], wi * simplex[ki, 2]
    if kj >= 0:
        vx += wj * simplex[kj, 0]
        vy += wj * simplex[kj, 1]
        vz += wj * simplex[kj, 2]
    if kk >= 0:
        vx += wk * simplex[kk, 0]
        vy += wk * simplex[kk, 1]
        vz += wk * simplex[kk, 2]
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
    return kept, vx, vy, vz


@inner_kernel
def _inside(simplex: Array) -> bool:
    """Tell whether the origin is inside a tetrahedron; one that is flat has no inside."""
    for s in range(4):
        p, q, r = (s + 1) % 4, (s + 2) % 4, (s + 3) % 4
        px, py, pz = simplex[p, 0], simplex[p, 1], simplex[p, 2]
        ux, uy, uz = simplex[q, 0] - px, simplex[q, 1] - py, simplex[q, 2] - pz
        wx, wy, wz = simplex[r, 0] - px, simplex[r, 1] - py, simplex[r, 2] - pz
        nx, ny, nz = uy * wz - uz * wy, uz * wx - ux * wz, ux * wy - uy * wx
        origin = -(nx * px + ny * py + nz * pz)
        ox, oy, oz = simplex[s, 0] - px, simplex[s, 1] - py, simplex[s, 2] - pz
        corner = nx * ox + ny * oy + nz * oz
        long = ux * ux + uy * uy + uz * uz + wx * wx + wy * wy + wz * wz
        if corner * corner <= _FLAT * long * long * long:
            return False
        if not origin * corner >= 0.0:
            return False
    return True


@inner_kernel
def _well_inside(simplex: Array) -> bool:
    """Tell whether the origin is inside a tetrahedron beyond rounding errors."""
    for s in range(4):
        p = simplex[(s + 1) % 4]
        q = simplex[(s + 2) % 4]
        r = simplex[(s + 3) % 4]
        ux, uy, uz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
        wx, wy, wz = r[0] - p[0], r[1] - p[1], r[2] - p[2]
        nx, ny, nz = uy * wz - uz * wy, uz * wx - ux * wz, ux * wy - uy * wx
        area = np.sqrt(nx * nx + ny * ny + nz * nz)
        if area < _SLIVER:
            return False
        origin = -(nx * p[0] + ny * p[1] + nz * p[2]) / area
        o = simplex[s]
        corner = nx * (o[0] - p[0]) + ny * (o[1] - p[1]) + nz * (o[2] - p[2])
        if corner < 0.0:
            origin, corner = -origin, -corner
        # All four corners may be in one plane.
        if corner < _CERTAIN * area or origin < _CERTAIN:
            return False
    return True
