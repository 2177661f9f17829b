"""Axis-aligned boxes: rows of least and greatest corners, shape (b, 6) [m]."""

from __future__ import annotations

from planning.kernels import inner_kernel
from planning.transforms import Array


@inner_kernel
def boxes_apart(a: Array, i: int, b: Array, j: int, gap: float) -> bool:
    """Tell whether box ``i`` of the one table is further than a gap from ``j`` of the other."""
    for r in range(3):
        if a[i, r] - b[j, r + 3] > gap or b[j, r] - a[i, r + 3] > gap:
            return True
    return False
