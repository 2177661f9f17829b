"""Classification of the distance of two convex hulls (GJK), in compiled code."""

from __future__ import annotations

import numpy as np

from planning.kernels import inner_kernel
from planning.packed import stack_rows
from planning.transforms import Array

FAR, BETWEEN, CLOSE, TOO_CLOSE = 1, 0, -1, -2
"""Classification of two hulls, see ``classify_gap``."""

_STEPS = 24
ROUNDING = 1e-9
"""Margin for rounding errors, added to every distance that must be proved [m]."""

_CERTAIN = 1e-7
"""Margin by which hulls must be too close, or overlap, to count as certain [m]."""

_FLAT = 1e-22
"""Squared height of a tetrahedron against its edges from which on rounding decides its sides."""

_SLIVER = 1e-10
"""Faces of a smaller area have no reliable side [m^2]."""


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
