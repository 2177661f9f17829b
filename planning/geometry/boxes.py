"""Axis-aligned boxes: rows of least and greatest corners, shape (b, 6) [m]."""

from __future__ import annotations

from planning.kernels import inner_kernel
from planning.transforms import Array


@inner_kernel
def boxes_apart(a: Array, i: int, b: Array, j: int, gap: float) -> bool:
    """Tell whether box ``i`` of the one table is further than a gap from ``j`` of the other."""
    return bool(
        a[i, 0] - b[j, 3] > gap
        or b[j, 0] - a[i, 3] > gap
        or a[i, 1] - b[j, 4] > gap
        or b[j, 1] - a[i, 4] > gap
        or a[i, 2] - b[j, 5] > gap
        or b[j, 2] - a[i, 5] > gap
    )
