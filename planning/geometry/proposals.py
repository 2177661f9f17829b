"""Capsules against a standing scene, compiled: which bodies may touch, and when on a motion."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from planning.cell.compiled_robot import RobotKernel
from planning.geometry.distance import segment_box, segment_segment
from planning.geometry.swept import place_capsules
from planning.transforms import Array, Indices

SKIP = -1.0
"""In a table of limits: this pair is never checked."""

BOX, SOLID, SELF = 0, 1, 2


class Scene(NamedTuple):
    """What a robot may not come close to, as flat arrays.

    Attributes:
        box_pose: pose of every box, shape (b, 4, 4).
        box_half: half edge lengths, shape (b, 3).
        box_bounds: least and greatest corner of each, shape (b, 6).
        box_limit: least distance of each own body to each box, SKIP for none, shape (o, b).
        start, end, radius: capsules of the other obstacles, shapes (c, 3), (c, 3), (c,).
        first: capsules of obstacle s are ``first[s]:first[s + 1]``, shape (s + 1,).
        solid_bounds: least and greatest corner of each obstacle, shape (s, 6).
        solid_limit: least distance of each own body to each obstacle, shape (o, s).
        self_limit: least distance between own bodies, upper triangle, shape (o, o).
        own_first: capsules of own body o are ``own_first[o]:own_first[o + 1]``.
    """

    box_pose: Array
    box_half: Array
    box_bounds: Array
    box_limit: Array
    start: Array
    end: Array
    radius: Array
    first: Indices
    solid_bounds: Array
    solid_limit: Array
    self_limit: Array
    own_first: Indices


@njit(cache=True, nogil=True)
def _bound_bodies(
    kernel: RobotKernel,
    own_first: Indices,
    start: Array,
    end: Array,
    moved: Array,
    bounds: Array,
) -> None:
    """Write the least and greatest corner of every own body's swept capsules, shape (o, 6)."""
    for o in range(own_first.shape[0] - 1):
        for r in range(3):
            bounds[o, r] = np.inf
            bounds[o, r + 3] = -np.inf
        for c in range(own_first[o], own_first[o + 1]):
            grown = kernel.radius[c] + moved[c, 0]
            for r in range(3):
                low = min(start[c, r], end[c, r]) - grown
                high = max(start[c, r], end[c, r]) + grown
                bounds[o, r] = min(bounds[o, r], low)
                bounds[o, r + 3] = max(bounds[o, r + 3], high)


@njit(cache=True, inline="always")
def _apart(a: Array, i: int, b: Array, j: int, limit: float) -> bool:
    return bool(
        a[i, 0] - b[j, 3] > limit
        or b[j, 0] - a[i, 3] > limit
        or a[i, 1] - b[j, 4] > limit
        or b[j, 1] - a[i, 4] > limit
        or a[i, 2] - b[j, 5] > limit
        or b[j, 2] - a[i, 5] > limit
    )


@njit(cache=True, nogil=True)
def _hits(
    kernel: RobotKernel,
    scene: Scene,
    start: Array,
    end: Array,
    moved: Array,
    bounds: Array,
    resolution: float,
    out: Indices,
) -> int:
    """Write (kind, own body, other) of every close pair; -1 asks for a shorter stretch first."""
    count = 0
    for o in range(scene.own_first.shape[0] - 1):
        low, high = scene.own_first[o], scene.own_first[o + 1]
        for b in range(scene.box_bounds.shape[0]):
            limit = scene.box_limit[o, b]
            if limit < 0.0 or _apart(bounds, o, scene.box_bounds, b, limit):
                continue
            for c in range(low, high):
                near = kernel.radius[c] + moved[c, 0] + limit
                gap = segment_box(
                    start[c], end[c], scene.box_pose[b], scene.box_half[b]
                )
                if gap <= near * near:
                    if moved[c, 0] > resolution:
                        return -1
                    count = _note(out, count, BOX, o, b)
                    break
        for s in range(scene.solid_bounds.shape[0]):
            limit = scene.solid_limit[o, s]
            if limit < 0.0 or _apart(bounds, o, scene.solid_bounds, s, limit):
                continue
            noted = count
            for c in range(low, high):
                for d in range(scene.first[s], scene.first[s + 1]):
                    near = kernel.radius[c] + moved[c, 0] + scene.radius[d] + limit
                    gap = segment_segment(
                        start[c], end[c], scene.start[d], scene.end[d]
                    )
                    if gap <= near * near:
                        if moved[c, 0] > resolution:
                            return -1
                        count = _note(out, noted, SOLID, o, s)
        for p in range(o):
            limit = scene.self_limit[p, o]
            if limit < 0.0 or _apart(bounds, o, bounds, p, limit):
                continue
            # Seen from the joint that carries the lower body, only the joints above it move.
            root = kernel.joint[scene.own_first[p]]
            root = min(root, kernel.joint[low]) + 1
            noted = count
            for c in range(low, high):
                for d in range(scene.own_first[p], scene.own_first[p + 1]):
                    strayed = moved[c, root] + moved[d, root]
                    near = kernel.radius[c] + kernel.radius[d] + strayed + limit
                    gap = segment_segment(start[c], end[c], start[d], end[d])
                    if gap <= near * near:
                        if strayed > resolution:
                            return -1
                        count = _note(out, noted, SELF, p, o)
    return count


@njit(cache=True, inline="always")
def _note(out: Indices, count: int, kind: int, body: int, other: int) -> int:
    if count < out.shape[0]:
        out[count, 0], out[count, 1], out[count, 2] = kind, body, other
    return count + 1


@njit(cache=True, nogil=True)
def propose(
    kernel: RobotKernel,
    scene: Scene,
    q_a: Array,
    q_b: Array,
    resolution: float,
    room: int,
) -> tuple[Array, Indices, int]:
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
    own = scene.own_first.shape[0] - 1
    start = np.empty((caps, 3))
    end = np.empty((caps, 3))
    moved = np.empty((caps, n + 1))
    bounds = np.empty((own, 6))
    poses = np.empty((n + 1, 4, 4))
    q_mid = np.empty(n)
    most = own * (scene.box_half.shape[0] + scene.solid_bounds.shape[0] + own)
    pairs = np.empty((most, 3), dtype=np.int64)
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
            kernel, q_a + lo * step, q_a + hi * step, poses, q_mid, start, end, moved
        )
        _bound_bodies(kernel, scene.own_first, start, end, moved, bounds)
        found = _hits(kernel, scene, start, end, moved, bounds, resolution, pairs)
        if found < 0:
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
