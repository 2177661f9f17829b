"""Collision checks of whole motions among static obstacles, in compiled code.

A motion is halved repeatedly to find pairs of bodies whose capsules are close. Pairs whose hulls are proved apart are
removed. Undecided pairs are returned; the caller computes their exact distances.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from planning.geometry.distance import are_boxes_apart
from planning.geometry.exact import TOLERANCE
from planning.geometry.hull_table import HullTable
from planning.geometry.separation import (
    APART,
    CONFLICT,
    Scratch,
    check_hulls_continuously,
    pose_segments,
)
from planning.geometry.swept import (
    SweptBodies,
    deviation_bound_at_box,
    deviation_bound_where_meeting,
    set_stretch,
    sweep_bodies,
)
from planning.kernels import ZERO, inner_kernel, kernel
from planning.transforms import Array, Indices

BOX, SELF = 0, 1
"""Kinds of pairs: a body of the robot with a box of an obstacle, or with another body of the robot."""

_RESOLUTION = 0.1
"""Greatest displacement of links on a stretch of a motion for which hulls are compared instead of capsules [m].

A comparison of moving hulls is slower, but decides longer stretches than capsules do.
"""

_ROOM = ZERO + 512

HIT, CLEAR = -1, -2
"""Results in place of the number of a probe: the robot is too close to an obstacle, or everywhere clear."""

_PROBE = 0.35
"""Greatest joint travel between configurations that are probed before the whole motion is checked [rad]."""

_GROUP = 16
"""Size of groups of boxes that are skipped together if a body is far from all of them."""


class CompiledScene(NamedTuple):
    """A robot and its obstacles, for compiled code.

    Attributes:
        own: bodies of the robot on a stretch of its motion.
        boxes: hulls of static obstacles, each with a bounding box.
        box_pose: pose of each box, shape (b, 4, 4).
        box_half: half edge lengths of each box, shape (b, 3) [m].
        box_bounds: least and greatest coordinates of each box, shape (b, 6) [m].
        box_limit: least distance between each own body and each box, SKIP for none, shape (o, b) [m].
        self_limit: least distance between own bodies, upper triangle, shape (o, o) [m].
        above: own bodies on the stretch, relative to a joint.
        on_standing, on_itself: work arrays to compare own hulls with static ones, and with each other.
        apart: last direction that separated two own hulls, in the frame of their lower joint, shape (o, o, 3).
    """

    own: SweptBodies
    boxes: HullTable
    box_pose: Array
    box_half: Array
    box_bounds: Array
    box_limit: Array
    self_limit: Array
    above: HullTable
    on_standing: Scratch
    on_itself: Scratch
    apart: Array


@inner_kernel
def _group_boxes(bounds: Array) -> Array:
    """Return the bounding boxes of consecutive groups of boxes."""
    count = bounds.shape[0]
    groups = (count + _GROUP - 1) // _GROUP
    out = np.empty((groups, 6))
    for g in range(groups):
        for r in range(3):
            low, high = np.inf, -np.inf
            for p in range(g * _GROUP, min((g + 1) * _GROUP, count)):
                low, high = min(low, bounds[p, r]), max(high, bounds[p, r + 3])
            out[g, r], out[g, r + 3] = low, high
    return out


@inner_kernel
def _pairs_with_boxes(
    scene: CompiledScene, groups: Array, room: float, out: Indices
) -> int:
    """Write (BOX, own body, box) of every close pair; -1 requests a shorter stretch first.

    Args:
        scene: the robot and what stands around it.
        groups: see ``_group_boxes``.
        room: the greatest of the least distances to boxes [m].
        out: the pairs.
    """
    own, bounds, limits = scene.own, scene.box_bounds, scene.box_limit
    box, poses, halves = own.sweeps.body_box, scene.box_pose, scene.box_half
    last = bounds.shape[0]
    count = 0
    for o in range(box.shape[0]):
        for g in range(groups.shape[0]):
            if are_boxes_apart(box, o, groups, g, room):
                continue
            for p in range(g * _GROUP, min((g + 1) * _GROUP, last)):
                limit = limits[o, p]
                if limit < 0.0 or are_boxes_apart(box, o, bounds, p, limit):
                    continue
                strayed = deviation_bound_at_box(own, o, poses[p], halves[p], limit)
                if strayed > _RESOLUTION:
                    return -1
                if strayed >= 0.0:
                    out[count, 0], out[count, 1], out[count, 2] = BOX, o, p
                    count += 1
    return count


@inner_kernel
def _pairs_within(scene: CompiledScene, count: int, out: Indices) -> int:
    """Write (SELF, own body, own body) of every close pair after others; see _pairs_with_boxes."""
    own, limits = scene.own, scene.self_limit
    box, joint = own.sweeps.body_box, own.hulls.joint
    for o in range(box.shape[0]):
        for p in range(o):
            limit = limits[p, o]
            if limit < 0.0 or are_boxes_apart(box, o, box, p, limit):
                continue
            # Seen from the joint that carries the lower body, only those above move.
            root = min(joint[p], joint[o])
            strayed = deviation_bound_where_meeting(own, o, p, root, limit, _RESOLUTION)
            if strayed > _RESOLUTION:
                return -1
            if strayed >= 0.0:
                out[count, 0], out[count, 1], out[count, 2] = SELF, p, o
                count += 1
    return count


@inner_kernel
def pose_joints_above(
    whole: HullTable, above: HullTable, root: int, scratch: Scratch
) -> None:
    """Pose a stretch relative to a joint: only the joints above it move.

    Joints below are set to zero, so that results of other motions can be reused.

    Args:
        whole: bodies on the stretch.
        above: the same bodies, which are posed relative to the joint.
        root: the joint.
        scratch: work arrays to compare ``above`` with itself.
    """
    for j in range(whole.q_a.shape[1]):
        a, b = whole.q_a[0, j], whole.q_b[0, j]
        if j <= root:
            a = b = 0.0
        above.q_a[0, j], above.q_b[0, j] = a, b
    scratch.posed[0] = scratch.posed[1] = -1
    pose_segments(above, ZERO, above, ZERO, scratch)


@inner_kernel
def _keep_unproved(scene: CompiledScene, pairs: Indices, count: int, stop: bool) -> int:
    """Move the pairs that are not proved apart to the front; return their number.

    With ``stop`` set, HIT is returned as soon as one of them is proved too close.
    """
    whole, above = scene.own.hulls, scene.above
    on_standing, on_itself = scene.on_standing, scene.on_itself
    on_standing.posed[0] = -1
    root = -2
    kept = 0
    for k in range(count):
        kind, i, j = pairs[k, 0], pairs[k, 1], pairs[k, 2]
        if kind == SELF:
            lower = min(whole.joint[i], whole.joint[j])
            if lower != root:
                root = lower
                pose_joints_above(whole, above, root, on_itself)
            for r in range(3):
                on_itself.direction[r] = scene.apart[i, j, r]
            # What the exact decision tolerates is left to it.
            limit = scene.self_limit[i, j] + TOLERANCE
            answer = check_hulls_continuously(above, i, above, j, limit, on_itself)
            for r in range(3):
                scene.apart[i, j, r] = on_itself.direction[r]
        else:
            limit, standing = scene.box_limit[i, j], scene.boxes
            pose_segments(whole, ZERO, standing, ZERO, on_standing)
            answer = check_hulls_continuously(whole, i, standing, j, limit, on_standing)
        if stop and answer == CONFLICT and kind != SELF:
            return HIT
        if answer != APART:
            for c in range(3):
                pairs[kept, c] = pairs[k, c]
            kept += 1
    return kept


@inner_kernel
def _search(
    scene: CompiledScene,
    groups: Array,
    room: float,
    q_a: Array,
    q_b: Array,
    lo: float,
    hi: float,
    stop: bool,
) -> tuple[int, Array, Indices]:
    """Return the undecided pairs on a stretch of a motion; their number is HIT for a proved conflict.

    The stretch is halved until in each part all capsules are clear, or those that are not move by at most the
    resolution.
    """
    own = len(scene.own.hulls.joint)
    most = own * (len(scene.box_half) + own)
    pairs = np.empty((most, 3), dtype=np.int64)
    when = np.empty((_ROOM, 2))
    what = np.empty((_ROOM, 3), dtype=np.int64)
    stack = np.empty((64, 2))
    stack[0, 0], stack[0, 1] = lo, hi
    depth = 1
    total = 0
    while depth > 0:
        depth -= 1
        lo, hi = stack[depth, 0], stack[depth, 1]
        set_stretch(scene.own.hulls, q_a, q_b, lo, hi)
        sweep_bodies(scene.own)
        count = _pairs_with_boxes(scene, groups, room, pairs)
        if count >= 0:
            count = _pairs_within(scene, count, pairs)
        if count < 0:
            middle = 0.5 * (lo + hi)
            stack[depth, 0], stack[depth, 1] = middle, hi
            stack[depth + 1, 0], stack[depth + 1, 1] = lo, middle
            depth += 2
            continue
        count = _keep_unproved(scene, pairs, count, stop)
        if count == HIT:
            return HIT, when[:0], what[:0]
        while total + count > len(when):
            when, what = np.concatenate((when, when)), np.concatenate((what, what))
        for i in range(count):
            when[total, 0], when[total, 1] = lo, hi
            for k in range(3):
                what[total, k] = pairs[i, k]
            total += 1
    return total, when[:total], what[:total]


@inner_kernel
def _probes(q_a: Array, q_b: Array) -> int:
    """Return how many configurations of a motion are probed before all of it: a power of two."""
    most, count = 0.0, 1
    for j in range(len(q_a)):
        most = max(most, abs(q_b[j] - q_a[j]))
    while count < int(most / _PROBE) + 1:
        count *= 2
    return count


@inner_kernel
def _share(probe: int) -> float:
    """Return the position of a probe on a motion: the end first, then ever finer in between."""
    share, step = 0.0 if probe > 0 else 1.0, 0.5
    while probe > 0:
        share += step * (probe % 2)
        step, probe = 0.5 * step, probe // 2
    return share


@kernel
def find_undecided(
    scene: CompiledScene,
    q_a: Array,
    q_b: Array,
    probing: bool,
    whole: bool,
    begin: int,
    stop: bool,
) -> tuple[int, Array, Indices]:
    """Probe some configurations of a motion, then check all of it, until a pair is undecided.

    Args:
        scene: the robot and what stands around it.
        q_a, q_b: ends of the motion, shape (n,).
        probing: whether to check single configurations first, which finds conflicts sooner.
        whole: whether to check the whole motion afterwards.
        begin: number of probes already done.
        stop: whether to stop at the first pair that is proved too close.

    Returns:
        The number of the probe with undecided pairs, CLEAR if everything is clear, or HIT for a pair that is too
        close; then, for the undecided pairs, the stretches as shares of the motion, shape (k, 2), and rows
        (kind, own body, other), shape (k, 3).
    """
    groups, room = _group_boxes(scene.box_bounds), 0.0
    for o in range(scene.box_limit.shape[0]):
        for b in range(scene.box_limit.shape[1]):
            room = max(room, scene.box_limit[o, b])
    probes = _probes(q_a, q_b) if probing else 0
    count, when, what = 0, np.empty((0, 2)), np.empty((0, 3), dtype=np.int64)
    for k in range(begin, probes + 1 if whole else probes):
        lo, hi = 0.0, 1.0
        if k < probes:
            lo = hi = _share(k)
        count, when, what = _search(scene, groups, room, q_a, q_b, lo, hi, stop)
        if count != 0:
            return HIT if count == HIT else k, when.copy(), what.copy()
    return CLEAR, when.copy(), what.copy()
