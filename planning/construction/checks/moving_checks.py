"""Collision checks against moving robots, in compiled code.

Time is divided into intervals of equal length, the time cells. In each of them, the volume that the motion sweeps must
be clear of the volumes that all other robots sweep in the same time cell. Otherwise the time cell is bisected, up to a
fixed depth. Two motions of the same time cell are then clear of each other at any delay within it, so they can become
nodes of a temporal plan graph (see ``export_motion_plan``).
"""

from __future__ import annotations

import numpy as np
from numba import boolean, float64

from planning.construction.checks.scene import (
    Checks,
    MoverScene,
    interpolate_configuration,
    sweep_stretch,
)
from planning.construction.checks.still_checks import STILL, is_clear_of_still_objects
from planning.construction.world.fleet import bodies_of, set_motion
from planning.construction.world.tracks import pieces_at
from planning.geometry.distance import are_boxes_apart
from planning.geometry.hull_table import HullTable
from planning.geometry.swept import set_stretch, sweep_piece
from planning.joint_motion.moving_pairs import are_pieces_apart
from planning.kernels import ZERO, inner_kernel, kernel
from planning.packed import ROW, SharedKernel
from planning.transforms import Array

_PROBE = 0.4
"""On motions longer than this, single configurations are checked first [s, rad or m]."""

_MOTION = ROW, float64, ROW, float64


def _first_meeting(
    scene: MoverScene, q0: Array, t0: float, q1: Array, t1: float
) -> float:
    """Return the time up to which a motion is clear of moving robots, infinity for all of it [s].

    Args:
        scene: the scene.
        q0, t0: configuration and time of its start, shape (n,).
        q1, t1: configuration and time of its end.
    """
    near, stack = scene.near, scene.stack
    sweep_stretch(scene, q0, t0, q1, t1, t0, t1)
    begin, finish = _cells(scene.step, t0, t1)
    tracks = ZERO
    for r in range(len(scene.tracks.first) - 1):
        p, q = _near_pieces(scene, r, begin, finish)
        if p < q:
            near[tracks] = r
            tracks += 1
    if tracks == 0:
        return np.inf
    stack[0, 0], stack[0, 1], stack[0, 2] = t0, t1, 0.0
    depth = 1
    while depth > 0:
        depth -= 1
        lo, hi = stack[depth, 0], stack[depth, 1]
        level = int(stack[depth, 2])
        if lo > t0 or hi < t1:
            sweep_stretch(scene, q0, t0, q1, t1, lo, hi)
        size = scene.step / (1 << level)
        begin, finish = _cells(size, lo, hi)
        single = finish - begin < 1.5 * size
        clear = True
        for k in range(tracks):
            p, q = _near_pieces(scene, near[k], begin, finish)
            if p < q and not (
                single and is_clear_of_pieces(scene, p, q, begin, finish)
            ):
                clear = False
                break
        if clear:
            continue
        if single:
            if level >= scene.halvings or hi - lo < 1e-9:
                return float(lo)
            level += 1
            middle = begin + 0.5 * size
            if middle <= lo + 1e-9 or middle >= hi - 1e-9:
                stack[depth, 2] = level
                depth += 1
                continue
        else:
            middle = begin + size * np.round(0.5 * (finish - begin) / size)
        if depth + 2 > len(stack):
            return float(lo)
        stack[depth, 0], stack[depth, 1], stack[depth, 2] = middle, hi, level
        stack[depth + 1, 0], stack[depth + 1, 1] = lo, middle
        stack[depth + 1, 2] = level
        depth += 2
    return np.inf


@inner_kernel
def _cells(size: float, lo: float, hi: float) -> tuple[float, float]:
    """Return the time cells that a span overlaps; an instant is left as it is."""
    if hi - lo < 1e-12:
        return lo, hi
    return np.floor(lo / size + 1e-6) * size, np.ceil(hi / size - 1e-6) * size


@inner_kernel
def _near_pieces(
    scene: MoverScene, track: int, begin: float, finish: float
) -> tuple[int, int]:
    """Return the pieces of a track in a time span, from the first one within reach on."""
    tracks = scene.tracks
    first, last = tracks.first[track], tracks.first[track + 1]
    start, end, box = tracks.pieces.start, tracks.pieces.end, tracks.sweeps.box
    p, q = pieces_at(start, end, first, last, begin, finish)
    while p < q and are_boxes_apart(scene.own.sweeps.box, ZERO, box, p, scene.widest):
        p += 1
    return p, q


@inner_kernel
def is_clear_of_tracks(scene: MoverScene, begin: float, finish: float) -> bool:
    """Check the swept robot against all pieces in a span."""
    for r in range(len(scene.tracks.first) - 1):
        p, q = _near_pieces(scene, r, begin, finish)
        if p < q and not is_clear_of_pieces(scene, p, q, begin, finish):
            return False
    return True


@inner_kernel
def is_clear_of_pieces(
    scene: MoverScene, p: int, q: int, begin: float, finish: float
) -> bool:
    """Check the swept robot against pieces ``range(p, q)`` of one track within a span."""
    own, widest, limits = scene.own, scene.widest, scene.limits.entities
    tracks, bodies, entity = scene.tracks, scene.fleet.body_first, scene.entity
    mine = (own.hulls, own.sweeps, ZERO, entity[: bodies[1]])
    for i in range(p, q):
        if are_boxes_apart(own.sweeps.box, ZERO, tracks.sweeps.box, i, widest):
            continue
        v = tracks.carrier[i]
        hulls, names = bodies_of(scene.fleet, v), entity[bodies[v] : bodies[v + 1]]
        swept, piece = tracks.sweeps, i
        if _clip(scene, hulls, i, begin, finish):
            swept, piece = scene.other, ZERO
        theirs = (hulls, swept, piece, names)
        if not are_pieces_apart(
            mine, theirs, limits, widest, scene.pairs, scene.scratch
        ):
            return False
    return True


@inner_kernel
def _clip(
    scene: MoverScene, hulls: HullTable, piece: int, begin: float, finish: float
) -> bool:
    """Clip a piece of a carrier's motion to a time span; tell whether only a part of it is inside.

    If so, the swept volume of that part is computed.
    """
    pieces = scene.tracks.pieces
    start, end = pieces.start[piece], pieces.end[piece]
    set_motion(hulls, pieces.q_a[piece], pieces.q_b[piece])
    if pieces.whole[piece] or not (start < begin - 1e-9 or end > finish + 1e-9):
        return False
    q_a, q_b = hulls.q_a[0], hulls.q_b[0]
    moves = False
    for j in range(len(q_a)):
        moves = moves or q_a[j] != q_b[j]
    if not moves:
        return False
    x = min(max((begin - start) / (end - start), 0.0), 1.0)
    y = min(max((finish - start) / (end - start), 0.0), 1.0)
    # Configurations of pieces are padded to the most joints.
    n = len(q_a)
    set_stretch(hulls, pieces.q_a[piece, :n], pieces.q_b[piece, :n], x, y)
    sweep_piece(hulls, q_a, q_b, ZERO, scene.other, scene.other_room)
    return True


@inner_kernel
def first_conflict_time(
    scene: MoverScene, q0: Array, t0: float, q1: Array, t1: float
) -> float:
    """Return when a motion first collides with other robots, infinity for never [s].

    Three configurations are checked before the whole motion, so the result need not be the first collision.
    """
    q = np.empty_like(q0)
    if needs_probing(q0, t0, q1, t1):
        for share in (0.5, 0.25, 0.75):
            t = t0 + share * (t1 - t0)
            interpolate_configuration(q0, t0, q1, t1, t, q)
            sweep_stretch(scene, q, t, q, t, t, t)
            if not is_clear_of_tracks(scene, t, t):
                return t
    return first_meeting_time(scene, q0, t0, q1, t1)


@inner_kernel
def earliest_free_time(scene: MoverScene, q: Array, t: float, latest: float) -> float:
    """Return the time from which a configuration is clear of other robots [s].

    Args:
        scene: the scene.
        q: the configuration, shape (n,).
        t: first time to check [s].
        latest: last time to check; a returned time after it may not be clear [s].
    """
    sweep_stretch(scene, q, t, q, t, t, t)
    around, widest, tracks = scene.own.sweeps.box, scene.widest, scene.tracks
    start, end, box = tracks.pieces.start, tracks.pieces.end, tracks.sweeps.box
    waited = True
    while waited and t < latest:
        waited = False
        for r in range(len(tracks.first) - 1):
            last = tracks.first[r + 1]
            p, _ = pieces_at(start, end, tracks.first[r], last, t, t)
            while p < last and start[p] <= t + 1e-9 and t < latest:
                if are_boxes_apart(around, ZERO, box, p, widest):
                    break
                if is_clear_of_pieces(scene, p, p + 1, start[p], end[p]):
                    break
                t, waited = end[p], True
                p += 1
    return t


@inner_kernel
def needs_probing(q0: Array, t0: float, q1: Array, t1: float) -> bool:
    """Tell whether a motion is long enough to probe some configurations before checking all of it."""
    widest = t1 - t0
    for j in range(len(q0)):
        widest = max(widest, abs(q1[j] - q0[j]))
    return bool(widest > _PROBE)


@kernel
def is_clear_throughout(
    scene: MoverScene, q0: Array, q1: Array, lo: float, hi: float
) -> bool:
    """Tell whether a straight motion is clear of everything over its whole time span.

    Args:
        scene: the scene.
        q0, q1: ends of the motion, shape (n,).
        lo, hi: the span [s].
    """
    if not is_clear_of_still_objects(scene, q0, lo, q1, hi, hi - lo):
        return False
    size = scene.step / (1 << scene.halvings)
    begin = np.floor(lo / size + 1e-6) * size
    finish = np.ceil(hi / size - 1e-6) * size
    sweep_stretch(scene, q0, lo, q1, hi, lo, hi)
    return is_clear_of_tracks(scene, begin, finish)


def _configuration_clear(scene: MoverScene, q: Array, t: float) -> bool:
    # At a single instant, robots are the most frequent obstacles.
    sweep_stretch(scene, q, t, q, t, t, t)
    return is_clear_of_tracks(scene, t, t) and is_clear_of_still_objects(
        scene, q, t, q, t, 0.0
    )


def _motion_clear(
    scene: MoverScene, q0: Array, t0: float, q1: Array, t1: float
) -> bool:
    """Tell whether a whole motion is clear: its end and its midpoint are checked first."""
    if not is_configuration_clear(scene, q1, t1):
        return False
    if needs_probing(q0, t0, q1, t1):
        q, middle = np.empty_like(q0), 0.5 * (t0 + t1)
        interpolate_configuration(q0, t0, q1, t1, middle, q)
        if not is_configuration_clear(scene, q, middle):
            return False
    # It takes many more stretches to tell that it is clear of static obstacles.
    return first_meeting_time(
        scene, q0, t0, q1, t1
    ) == np.inf and is_clear_of_still_objects(scene, q0, t0, q1, t1, 0.0)


CHECKS = Checks(
    STILL,
    SharedKernel(_first_meeting, float64, _MOTION),
    SharedKernel(_configuration_clear, boolean, (ROW, float64)),
    SharedKernel(_motion_clear, boolean, _MOTION),
)
_meeting = CHECKS.meeting.call_of("meeting")
_configuration = CHECKS.configuration.call_of("configuration")
_motion = CHECKS.motion.call_of("motion")


@inner_kernel
def first_meeting_time(
    scene: MoverScene, q0: Array, t0: float, q1: Array, t1: float
) -> float:
    """Return the time up to which a motion is clear of moving robots, infinity for all of it [s]."""
    return float(_meeting(scene, (q0, float(t0), q1, float(t1))))


@kernel
def is_configuration_clear(scene: MoverScene, q: Array, t: float) -> bool:
    """Tell whether the robot may be at ``q``, shape (n,), at one instant."""
    return bool(_configuration(scene, (q, float(t))))


@kernel
def is_motion_clear(
    scene: MoverScene, q0: Array, t0: float, q1: Array, t1: float
) -> bool:
    """Tell whether a whole motion is clear."""
    return bool(_motion(scene, (q0, float(t0), q1, float(t1))))
