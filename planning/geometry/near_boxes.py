"""Boxes within reach of a robot on a path: a coarse, safe choice before exact checks."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from planning.cell.compiled_robot import RobotKernel
from planning.geometry.distance import segment_box
from planning.geometry.swept import sweep_segments
from planning.kernels import kernel
from planning.transforms import Array


def boxes_in_reach(
    kernel: RobotKernel,
    path: Array,
    pose: Array,
    half: Array,
    room: float,
) -> npt.NDArray[np.bool_]:
    """Return which boxes anything on a path may come near to.

    Args:
        kernel: the robot with all it ever holds on the path.
        path: configurations joined by straight lines, shape (w, n).
        pose: poses of the boxes, shape (b, 4, 4).
        half: their half edge lengths, shape (b, 3) [m].
        room: least distance that matters [m].

    Returns:
        Shape (b,). Boxes that are left out keep more than ``room`` from every swept capsule.
    """
    path = np.ascontiguousarray(path, dtype=np.float64)
    start, end, radius = sweep_segments(kernel, path[:-1], path[1:])
    return _near(
        start,
        end,
        radius + room,
        np.ascontiguousarray(pose, dtype=np.float64),
        np.ascontiguousarray(half, dtype=np.float64),
    )


@kernel
def _near(
    start: Array, end: Array, reach: Array, pose: Array, half: Array
) -> npt.NDArray[np.bool_]:
    count = pose.shape[0]
    segments, capsules = reach.shape
    out = np.zeros(count, dtype=np.bool_)
    for b in range(count):
        x, y, z = pose[b, 0, 3], pose[b, 1, 3], pose[b, 2, 3]
        size = np.sqrt(half[b, 0] ** 2 + half[b, 1] ** 2 + half[b, 2] ** 2)
        for s in range(segments):
            for c in range(capsules):
                # The distance to the middle of the capsule rules out most.
                dx = 0.5 * (start[s, c, 0] + end[s, c, 0]) - x
                dy = 0.5 * (start[s, c, 1] + end[s, c, 1]) - y
                dz = 0.5 * (start[s, c, 2] + end[s, c, 2]) - z
                ex = end[s, c, 0] - start[s, c, 0]
                ey = end[s, c, 1] - start[s, c, 1]
                ez = end[s, c, 2] - start[s, c, 2]
                length = 0.5 * np.sqrt(ex * ex + ey * ey + ez * ez)
                far = size + length + reach[s, c]
                if dx * dx + dy * dy + dz * dz > far * far:
                    continue
                squared = segment_box(start[s, c], end[s, c], pose[b], half[b])
                if squared <= reach[s, c] * reach[s, c]:
                    out[b] = True
                    break
            if out[b]:
                break
    return out
