"""Forward kinematics of serial chains, compiled."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit

from planning.transforms import Array


@njit(cache=True, fastmath=False)
def joint_poses(
    placement: Array,
    axis: Array,
    prismatic: npt.NDArray[np.bool_],
    base: Array,
    q: Array,
    out: Array,
) -> None:
    """Write the world pose of the base and of every joint frame after its motion.

    Args:
        placement, axis, prismatic: see KinematicChain.
        base: pose of the base in the world, shape (4, 4).
        q: joint values, shape (n,).
        out: shape (n + 1, 4, 4); ``out[0]`` becomes the base, ``out[j + 1]`` joint j.
    """
    n = q.shape[0]
    for r in range(4):
        for c in range(4):
            out[0, r, c] = base[r, c]
    move = np.zeros((3, 3))
    for j in range(n):
        parent = out[j]
        pose = out[j + 1]
        local = placement[j]
        x, y, z = axis[j, 0], axis[j, 1], axis[j, 2]
        if prismatic[j]:
            tx = local[0, 3] + q[j] * (
                local[0, 0] * x + local[0, 1] * y + local[0, 2] * z
            )
            ty = local[1, 3] + q[j] * (
                local[1, 0] * x + local[1, 1] * y + local[1, 2] * z
            )
            tz = local[2, 3] + q[j] * (
                local[2, 0] * x + local[2, 1] * y + local[2, 2] * z
            )
            for r in range(3):
                for c in range(3):
                    move[r, c] = 1.0 if r == c else 0.0
        else:
            tx, ty, tz = local[0, 3], local[1, 3], local[2, 3]
            cq, sq = np.cos(q[j]), np.sin(q[j])
            v = 1.0 - cq
            move[0, 0], move[0, 1], move[0, 2] = (
                cq + x * x * v,
                x * y * v - z * sq,
                x * z * v + y * sq,
            )
            move[1, 0], move[1, 1], move[1, 2] = (
                y * x * v + z * sq,
                cq + y * y * v,
                y * z * v - x * sq,
            )
            move[2, 0], move[2, 1], move[2, 2] = (
                z * x * v - y * sq,
                z * y * v + x * sq,
                cq + z * z * v,
            )
        for r in range(3):
            a0 = (
                parent[r, 0] * local[0, 0]
                + parent[r, 1] * local[1, 0]
                + parent[r, 2] * local[2, 0]
            )
            a1 = (
                parent[r, 0] * local[0, 1]
                + parent[r, 1] * local[1, 1]
                + parent[r, 2] * local[2, 1]
            )
            a2 = (
                parent[r, 0] * local[0, 2]
                + parent[r, 1] * local[1, 2]
                + parent[r, 2] * local[2, 2]
            )
            for c in range(3):
                pose[r, c] = a0 * move[0, c] + a1 * move[1, c] + a2 * move[2, c]
            pose[r, 3] = (
                parent[r, 0] * tx + parent[r, 1] * ty + parent[r, 2] * tz + parent[r, 3]
            )
        pose[3, 0] = pose[3, 1] = pose[3, 2] = 0.0
        pose[3, 3] = 1.0
