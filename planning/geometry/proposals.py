"""Capsules against a standing scene, compiled: which bodies may touch, and when on a motion."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from planning.geometry.distance import segment_box, segment_segment
from planning.geometry.kernel import RobotKernel
from planning.geometry.swept import place_capsules
from planning.transforms import Array

SKIP = -1.0
"""In a table of limits: this pair is never checked."""


class Scene(NamedTuple):
    """What a robot may not come close to, as flat arrays.

    Attributes:
        box_pose: pose of every box, shape (b, 4, 4).
        box_half: half edge lengths, shape (b, 3).
        box_radius: radius of the sphere around each box, shape (b,).
        box_limit: least distance of each own body to each box, SKIP for none, shape (o, b).
        start, end, radius: capsules of other robots, shapes (c, 3), (c, 3), (c,).
        solid: index of the obstacle of each of those capsules, shape (c,).
        solid_limit: least distance of each own body to each such obstacle, shape (o, s).
        self_limit: least distance between own bodies, upper triangle, shape (o, o).
    """

    box_pose: Array
    box_half: Array
    box_radius: Array
    box_limit: Array
    start: Array
    end: Array
    radius: Array
    solid: npt.NDArray[np.int64]
    solid_limit: Array
    self_limit: Array


BOX, SOLID, SELF = 0, 1, 2


@njit(cache=True)
def _hits(
    kernel: RobotKernel,
    scene: Scene,
    start: Array,
    end: Array,
    radius: Array,
    resolution: float,
    out: npt.NDArray[np.int64],
) -> int:
    """Write (kind, own body, other) of every close pair; -1 asks for a finer interval first."""
    count = 0
    own = kernel.radius.shape[0]
    for c in range(own):
        body = kernel.body[c]
        coarse = radius[c] - kernel.radius[c] > resolution
        mx = 0.5 * (start[c, 0] + end[c, 0])
        my = 0.5 * (start[c, 1] + end[c, 1])
        mz = 0.5 * (start[c, 2] + end[c, 2])
        dx, dy, dz = end[c, 0] - mx, end[c, 1] - my, end[c, 2] - mz
        ball = np.sqrt(dx * dx + dy * dy + dz * dz) + radius[c]
        for b in range(scene.box_radius.shape[0]):
            limit = scene.box_limit[body, b]
            if limit < 0.0:
                continue
            x = mx - scene.box_pose[b, 0, 3]
            y = my - scene.box_pose[b, 1, 3]
            z = mz - scene.box_pose[b, 2, 3]
            far = ball + scene.box_radius[b] + limit
            if x * x + y * y + z * z > far * far:
                continue
            near = radius[c] + limit
            gap = segment_box(start[c], end[c], scene.box_pose[b], scene.box_half[b])
            if gap <= near * near:
                if coarse:
                    return -1
                count = _note(out, count, BOX, body, b)
        for s in range(scene.radius.shape[0]):
            limit = scene.solid_limit[body, scene.solid[s]]
            if limit < 0.0:
                continue
            near = radius[c] + scene.radius[s] + limit
            if _apart(start[c], end[c], scene.start[s], scene.end[s], near):
                continue
            gap = segment_segment(start[c], end[c], scene.start[s], scene.end[s])
            if gap <= near * near:
                if coarse:
                    return -1
                count = _note(out, count, SOLID, body, scene.solid[s])
        for d in range(c):
            other = kernel.body[d]
            limit = scene.self_limit[min(body, other), max(body, other)]
            if limit < 0.0:
                continue
            near = radius[c] + radius[d] + limit
            if _apart(start[c], end[c], start[d], end[d], near):
                continue
            gap = segment_segment(start[c], end[c], start[d], end[d])
            if gap <= near * near:
                if coarse or radius[d] - kernel.radius[d] > resolution:
                    return -1
                count = _note(
                    out, count, SELF, min(body, other), max(body, other)
                )
    return count


@njit(cache=True, inline="always")
def _apart(a0: Array, a1: Array, b0: Array, b1: Array, near: float) -> bool:
    for r in range(3):
        if min(a0[r], a1[r]) - max(b0[r], b1[r]) > near:
            return True
        if min(b0[r], b1[r]) - max(a0[r], a1[r]) > near:
            return True
    return False


@njit(cache=True, inline="always")
def _note(
    out: npt.NDArray[np.int64], count: int, kind: int, body: int, other: int
) -> int:
    for i in range(count):
        if out[i, 0] == kind and out[i, 1] == body and out[i, 2] == other:
            return count
    if count < out.shape[0]:
        out[count, 0], out[count, 1], out[count, 2] = kind, body, other
        count += 1
    return count


@njit(cache=True)
def propose(
    kernel: RobotKernel,
    scene: Scene,
    q_a: Array,
    q_b: Array,
    resolution: float,
    room: int,
) -> tuple[Array, npt.NDArray[np.int64], int]:
    """Return the pairs of bodies that may touch on a straight motion, and where on it.

    The motion is halved until every stretch either clears all capsules or moves none of those
    that do not by more than ``resolution``.

    Args:
        kernel: the moving robot.
        scene: what stands around it.
        q_a, q_b: ends of the motion, shape (n,); equal for a single configuration.
        resolution: motion below which stretches are no longer split [m].
        room: proposals that fit in the answer.

    Returns:
        Stretches as parameters in [0, 1], shape (k, 2); rows (kind, own body, other), shape
        (k, 3); and k, or -1 when there were more than ``room``.
    """
    n = q_a.shape[0]
    caps = kernel.radius.shape[0]
    start = np.empty((caps, 3))
    end = np.empty((caps, 3))
    radius = np.empty(caps)
    poses = np.empty((n + 1, 4, 4))
    q_mid = np.empty(n)
    pairs = np.empty((256, 3), dtype=np.int64)
    when = np.empty((room, 2))
    what = np.empty((room, 3), dtype=np.int64)
    lows = np.empty(64)
    highs = np.empty(64)
    lows[0], highs[0] = 0.0, 1.0
    depth = 1
    total = 0
    step = q_b - q_a
    while depth > 0:
        depth -= 1
        lo, hi = lows[depth], highs[depth]
        place_capsules(
            kernel,
            q_a + lo * step,
            q_a + hi * step,
            poses,
            q_mid,
            start,
            end,
            radius,
        )
        found = _hits(kernel, scene, start, end, radius, resolution, pairs)
        if found < 0 and depth + 2 <= 64:
            middle = 0.5 * (lo + hi)
            lows[depth], highs[depth] = middle, hi
            lows[depth + 1], highs[depth + 1] = lo, middle
            depth += 2
            continue
        for i in range(found):
            if total == room:
                return when, what, -1
            when[total, 0], when[total, 1] = lo, hi
            for k in range(3):
                what[total, k] = pairs[i, k]
            total += 1
    return when, what, total
