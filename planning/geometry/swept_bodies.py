"""Capsules of whole bodies on a stretch of motion, and which of them meet, compiled."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planning.geometry.distance import segment_segment
from planning.geometry.hull_table import HullTable
from planning.geometry.swept import place_capsules
from planning.kernels import inner_kernel
from planning.packed import packed
from planning.transforms import Array

SKIP = -1.0
"""In a table of limits: this pair is never checked."""

NOWHERE = -1.0
"""How far bodies stray that do not meet."""


class SweptBodies(NamedTuple):
    """Bodies on a stretch of motion.

    Attributes:
        hulls: the bodies, on that stretch.
        start, end: capsules in the middle of the stretch, shape (c, 3) [m].
        moved: how far they stray from there, see ``place_capsules``, shape (c, n + 1) [m].
        box: least and greatest corner of each body, shape (o, 6) [m].
        poses, middle: joints in the middle, shapes (n + 1, 4, 4) and (n,).
    """

    hulls: HullTable
    start: Array
    end: Array
    moved: Array
    box: Array
    poses: Array
    middle: Array


def make_swept(hulls: HullTable) -> SweptBodies:
    """Return the bodies of a robot on a stretch of motion of their own, not swept yet."""
    n, capsules = hulls.q_a.shape[1], len(hulls.radius)
    swept = SweptBodies(
        hulls.on_a_motion(),
        np.empty((capsules, 3)),
        np.empty((capsules, 3)),
        np.zeros((capsules, n + 1)),
        np.empty((len(hulls.joint), 6)),
        np.empty((n + 1, 4, 4)),
        np.empty(n),
    )
    return packed(swept)


def stand_still(hulls: HullTable) -> SweptBodies:
    """Return bodies that rest in the world."""
    start, end = np.array(hulls.ends[:, 0]), np.array(hulls.ends[:, 1])
    first, radius = hulls.capsule_first, hulls.radius[:, None]
    low, high = np.minimum(start, end) - radius, np.maximum(start, end) + radius
    box = np.hstack(
        [np.minimum.reduceat(low, first[:-1]), np.maximum.reduceat(high, first[:-1])]
    )
    moved, poses, middle = np.zeros((len(start), 1)), np.empty((1, 4, 4)), np.empty(0)
    return packed(SweptBodies(hulls, start, end, moved, box, poses, middle))


@inner_kernel
def go_along(hulls: HullTable, q_a: Array, q_b: Array, lo: float, hi: float) -> None:
    """Make a stretch of a straight motion the one that bodies are on.

    Args:
        hulls: the bodies.
        q_a, q_b: ends of the motion, shape (n,).
        lo, hi: ends of the stretch as shares of it.
    """
    for j in range(len(q_a)):
        step = q_b[j] - q_a[j]
        hulls.q_a[0, j], hulls.q_b[0, j] = q_a[j] + lo * step, q_a[j] + hi * step


@inner_kernel
def sweep_bodies(
    bodies: SweptBodies, q_a: Array, q_b: Array, lo: float, hi: float
) -> None:
    """Sweep a robot's bodies along a stretch of a straight motion; see ``go_along``."""
    hulls = bodies.hulls
    first, radius = hulls.capsule_first, hulls.radius
    start, end, moved, box = bodies.start, bodies.end, bodies.moved, bodies.box
    go_along(hulls, q_a, q_b, lo, hi)
    place_capsules(
        hulls,
        hulls.q_a[0],
        hulls.q_b[0],
        bodies.poses,
        bodies.middle,
        start,
        end,
        moved,
    )
    for o in range(len(first) - 1):
        for r in range(3):
            low, high = np.inf, -np.inf
            for c in range(first[o], first[o + 1]):
                grown = radius[c] + moved[c, 0]
                low = min(low, min(start[c, r], end[c, r]) - grown)
                high = max(high, max(start[c, r], end[c, r]) + grown)
            box[o, r], box[o, r + 3] = low, high


@inner_kernel
def strays_where_they_meet(
    a: SweptBodies,
    i: int,
    b: SweptBodies,
    j: int,
    root: int,
    limit: float,
    enough: float,
) -> float:
    """Return how far capsules of two bodies stray that come closer than a limit.

    Args:
        a, i: bodies, and one of them.
        b, j: likewise for the other.
        root: the joint from which they are seen plus one; 0 for the world.
        limit: least distance [m].
        enough: the first that stray further are good enough to return [m].

    Returns:
        The largest sum of what two such capsules stray [m], NOWHERE where there are none.
    """
    strayed = NOWHERE
    a_first, b_first = a.hulls.capsule_first, b.hulls.capsule_first
    a_radius, b_radius = a.hulls.radius, b.hulls.radius
    for c in range(a_first[i], a_first[i + 1]):
        for d in range(b_first[j], b_first[j + 1]):
            both = a.moved[c, root] + b.moved[d, root]
            near = a_radius[c] + b_radius[d] + both + limit
            gap = segment_segment(a.start[c], a.end[c], b.start[d], b.end[d])
            if gap <= near * near:
                strayed = max(strayed, both)
                if strayed > enough:
                    return float(strayed)
    return strayed
