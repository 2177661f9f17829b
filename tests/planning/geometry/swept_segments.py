"""Swept capsules of many segments, for tests of the bounds."""

import numpy as np

from planning.geometry.hull_table import HullTable
from planning.geometry.swept import place_capsules
from planning.kernels import kernel
from planning.transforms import Array


@kernel
def sweep_segments(
    hulls: HullTable, q_a: Array, q_b: Array
) -> tuple[Array, Array, Array]:
    """Capsule starts and ends, shape (s, c, 3), and how far they stray, shape (s, c)."""
    count, n = q_a.shape
    c = len(hulls.radius)
    start, end = np.empty((count, c, 3)), np.empty((count, c, 3))
    strayed = np.empty((count, c))
    poses, q_mid, moved = np.empty((n + 1, 4, 4)), np.empty(n), np.empty((c, n + 1))
    for i in range(count):
        place_capsules(hulls, q_a[i], q_b[i], poses, q_mid, start[i], end[i], moved)
        strayed[i] = moved[:, 0]
    return start, end, strayed
