"""Pairs of bodies whose capsules come close on a motion in a standing scene, compiled."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planning.geometry.distance import boxes_apart, segment_box
from planning.geometry.hull_table import HullTable
from planning.geometry.separation import Scratch
from planning.geometry.swept_bodies import (
    SweptBodies,
    strays_where_they_meet,
    sweep_bodies,
)
from planning.kernels import ZERO, inner_kernel
from planning.transforms import Array, Indices

SKIP = -1.0
"""In a table of limits: this pair is never checked."""

BOX, SOLID, SELF = 0, 1, 2

RESOLUTION = 0.02
"""Stretches of a motion that move no link further than this go to the exact decision [m]."""


class Scene(NamedTuple):
    """A robot and what it may not come close to, for compiled code.

    Attributes:
        own: bodies of the robot on a stretch of its motion.
        others: bodies of robots that stand.
        boxes: corners of boxes that stand.
        box_pose: pose of every box, shape (b, 4, 4).
        box_half: half edge lengths, shape (b, 3).
        box_bounds: least and greatest corner of each, shape (b, 6).
        box_limit: least distance of each own body to each box, SKIP for none, shape (o, b).
        solid_limit: least distance of each own body to each other one, shape (o, s).
        self_limit: least distance between own bodies, upper triangle, shape (o, o).
        above: own bodies on the stretch as it is seen from a joint.
        on_standing, on_itself: room to compare own hulls with those that stand, and with each
            other.
    """

    own: SweptBodies
    others: SweptBodies
    boxes: HullTable
    box_pose: Array
    box_half: Array
    box_bounds: Array
    box_limit: Array
    solid_limit: Array
    self_limit: Array
    above: HullTable
    on_standing: Scratch
    on_itself: Scratch


@inner_kernel
def _hits(scene: Scene, out: Indices) -> int:
    """Write (kind, own body, other) of every close pair; -1 asks for a shorter stretch first."""
    own, others = scene.own, scene.others
    box, joint = own.box, own.hulls.joint
    count = 0
    for o in range(box.shape[0]):
        for b in range(scene.box_bounds.shape[0]):
            limit = scene.box_limit[o, b]
            if limit < 0.0 or boxes_apart(box, o, scene.box_bounds, b, limit):
                continue
            strayed = _strays_at_box(scene, o, b, limit)
            if strayed > RESOLUTION:
                return -1
            if strayed >= 0.0:
                out[count, 0], out[count, 1], out[count, 2] = BOX, o, b
                count += 1
        for s in range(others.box.shape[0]):
            limit = scene.solid_limit[o, s]
            if limit < 0.0 or boxes_apart(box, o, others.box, s, limit):
                continue
            strayed = strays_where_they_meet(own, o, others, s, ZERO, limit, RESOLUTION)
            if strayed > RESOLUTION:
                return -1
            if strayed >= 0.0:
                out[count, 0], out[count, 1], out[count, 2] = SOLID, o, s
                count += 1
        for p in range(o):
            limit = scene.self_limit[p, o]
            if limit < 0.0 or boxes_apart(box, o, box, p, limit):
                continue
            # Seen from the joint that carries the lower body, only the joints above it move.
            root = min(joint[p], joint[o]) + 1
            strayed = strays_where_they_meet(own, o, own, p, root, limit, RESOLUTION)
            if strayed > RESOLUTION:
                return -1
            if strayed >= 0.0:
                out[count, 0], out[count, 1], out[count, 2] = SELF, p, o
                count += 1
    return count


@inner_kernel
def _strays_at_box(scene: Scene, o: int, b: int, limit: float) -> float:
    """Return how far a capsule of an own body strays that meets a box, -1 where none does."""
    own, pose, half = scene.own, scene.box_pose[b], scene.box_half[b]
    for c in range(own.first[o], own.first[o + 1]):
        strayed = own.moved[c, 0]
        near = own.radius[c] + strayed + limit
        if segment_box(own.start[c], own.end[c], pose, half) <= near * near:
            return float(strayed)
    return -1.0


@inner_kernel
def propose(
    scene: Scene, q_a: Array, q_b: Array, lo: float, hi: float, room: int
) -> tuple[Array, Indices, int]:
    """Return the pairs of bodies that may touch on a stretch of a straight motion, and where.

    It is halved until every stretch either clears all capsules or moves none of those
    that do not by more than RESOLUTION.

    Args:
        scene: the robot and what stands around it.
        q_a, q_b: ends of the motion, shape (n,).
        lo, hi: ends of the stretch as shares of it; equal for a single configuration.
        room: proposals that fit in the answer.

    Returns:
        Stretches as shares of the motion, shape (k, 2); rows (kind, own body, other), shape
        (k, 3); and k, or -1 when there were more than ``room``.
    """
    own = scene.own.box.shape[0]
    most = own * (scene.box_half.shape[0] + scene.others.box.shape[0] + own)
    pairs = np.empty((most, 3), dtype=np.int64)
    when = np.empty((room, 2))
    what = np.empty((room, 3), dtype=np.int64)
    lows = np.empty(64)
    highs = np.empty(64)
    lows[0], highs[0] = lo, hi
    depth = 1
    total = 0
    while depth > 0:
        depth -= 1
        lo, hi = lows[depth], highs[depth]
        sweep_bodies(scene.own, q_a, q_b, lo, hi)
        found = _hits(scene, pairs)
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
