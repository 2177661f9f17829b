"""Collision checks against robots that move, compiled.

A motion is cut at the cells of time: in each cell the whole of its stretch must clear the whole
of what every other robot sweeps in the cell, and where that fails the cell is halved a few
times. So what is found free can become nodes of a temporal plan graph, see ``motion_pieces``.

Continuous collision checks of motions in space-time, compiled.
"""

from __future__ import annotations

import numpy as np

from planning.construction.checks.scene import (
    MoversScene,
    own_at,
    sweep_between,
    sweep_stretch,
)
from planning.construction.checks.still_checks import (
    capsules_meet,
    movers_clear,
    pairs_apart,
    still_clear_until,
)
from planning.construction.world.tracks import (
    Sweeps,
    bodies_of,
    near_stretch,
    pieces_at,
    set_motion,
    sweep_carrier,
)
from planning.geometry.distance import boxes_apart
from planning.geometry.hull_table import HullTable
from planning.kernels import ZERO, inner_kernel, kernel
from planning.transforms import Array

_PROBE = 0.4
"""Places on motions longer than this are looked at first [s, rad or m]."""


@inner_kernel
def moving_clear_until(
    scene: MoversScene, q0: Array, t0: float, q1: Array, t1: float
) -> tuple[bool, float]:
    """Tell whether a motion is clear of robots that move, and until when it is.

    Args:
        scene: the scene.
        q0, t0: where it begins, and when, shape (n,).
        q1, t1: where it ends, and when.
    """
    near, stack = scene.near, scene.stack
    several = len(scene.begin) > 1
    sweep_stretch(scene, q0, t0, q1, t1, t0, t1)
    begin, finish = _cells(scene.step, t0, t1)
    tracks = len(near) * 0
    for r in range(len(scene.tracks.first) - 1):
        p, q = _near_pieces(scene, r, begin, finish)
        if p < q:
            near[tracks] = r
            tracks += 1
    if tracks == 0 and not several:
        return True, t1
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
            if p < q and not (single and clear_of_pieces(scene, p, q, begin, finish)):
                clear = False
                break
        if clear and several:
            clear = movers_clear(scene, single)
        if clear:
            continue
        if single:
            if level >= scene.halvings or hi - lo < 1e-9:
                return False, lo
            level += 1
            middle = begin + 0.5 * size
            if middle <= lo + 1e-9 or middle >= hi - 1e-9:
                stack[depth, 2] = level
                depth += 1
                continue
        else:
            middle = begin + size * np.round(0.5 * (finish - begin) / size)
        if depth + 2 > len(stack):
            return False, lo
        stack[depth, 0], stack[depth, 1], stack[depth, 2] = middle, hi, level
        stack[depth + 1, 0], stack[depth + 1, 1] = lo, middle
        stack[depth + 1, 2] = level
        depth += 2
    return True, t1


@inner_kernel
def _cells(size: float, lo: float, hi: float) -> tuple[float, float]:
    """Return the cells of time that a span lies in; an instant is left as it is."""
    if hi - lo < 1e-12:
        return lo, hi
    return np.floor(lo / size + 1e-6) * size, np.ceil(hi / size - 1e-6) * size


@inner_kernel
def _near_pieces(
    scene: MoversScene, track: int, begin: float, finish: float
) -> tuple[int, int]:
    """Return the pieces of a track in a span, none where all are out of the movers' reach."""
    tracks = scene.tracks
    first, last = tracks.first[track], tracks.first[track + 1]
    start, end = tracks.pieces.start, tracks.pieces.end
    p, q = pieces_at(start, end, first, last, begin, finish)
    # The tree of a track has two nodes for each of its pieces.
    count, base = last - first, 2 * first
    around, widest = scene.own.box, scene.widest
    if near_stretch(tracks.tree, base, count, p - first, q - first, around, widest):
        return p, q
    return p, p


@inner_kernel
def clear_of_tracks(scene: MoversScene, begin: float, finish: float) -> bool:
    """Check the swept movers against all pieces in a span."""
    for r in range(len(scene.tracks.first) - 1):
        p, q = _near_pieces(scene, r, begin, finish)
        if p < q and not clear_of_pieces(scene, p, q, begin, finish):
            return False
    return True


@inner_kernel
def clear_of_pieces(
    scene: MoversScene, p: int, q: int, begin: float, finish: float
) -> bool:
    """Check the swept movers against pieces ``range(p, q)`` of one track within a span."""
    around, widest, limits = scene.own.box, scene.widest, scene.limits
    tracks, sweeps, bodies = scene.tracks, scene.tracks.sweeps, scene.fleet.body_first
    q_a, q_b = tracks.pieces.q_a, tracks.pieces.q_b
    for i in range(p, q):
        if boxes_apart(around, ZERO, sweeps.box, i, widest):
            continue
        v = tracks.carrier[i]
        hulls = bodies_of(scene.fleet, v)
        clipped = _clip(scene, hulls, i, begin, finish)
        if clipped:
            count = _near_bodies(scene, v, scene.other, (v * 0, v * 0))
        else:
            first = sweeps.body_first[i], sweeps.capsule_first[i]
            count = _near_bodies(scene, v, sweeps, first)
        if count == 0:
            continue
        if not clipped:
            set_motion(hulls, q_a[i], q_b[i])
        columns = scene.entity[bodies[v] : bodies[v + 1]]
        if not pairs_apart(scene, count, limits.entities, hulls, columns):
            return False
    return True


@inner_kernel
def _clip(
    scene: MoversScene, hulls: HullTable, piece: int, begin: float, finish: float
) -> bool:
    """Sweep only what of a piece falls into a span; False where that is all of it."""
    pieces = scene.tracks.pieces
    start, end = pieces.start[piece], pieces.end[piece]
    if pieces.whole[piece] or not (start < begin - 1e-9 or end > finish + 1e-9):
        return False
    from_q, to_q = pieces.q_a[piece], pieces.q_b[piece]
    n, moves = hulls.q_a.shape[1], False
    for j in range(n):
        moves = moves or from_q[j] != to_q[j]
    if not moves:
        return False
    x = min(max((begin - start) / (end - start), 0.0), 1.0)
    y = min(max((finish - start) / (end - start), 0.0), 1.0)
    q_a, q_b = hulls.q_a[0], hulls.q_b[0]
    for j in range(n):
        q_a[j] = from_q[j] + x * (to_q[j] - from_q[j])
        q_b[j] = from_q[j] + y * (to_q[j] - from_q[j])
    first = n * 0, n * 0
    sweep_carrier(hulls, q_a, q_b, first, scene.other, scene.other_moved, scene.room)
    return True


@inner_kernel
def _near_bodies(
    scene: MoversScene, v: int, other: Sweeps, first: tuple[int, int]
) -> int:
    """Collect the pairs of own bodies and of those of a carrier whose capsules meet.

    Args:
        scene: the scene, with the movers swept.
        v: the carrier.
        other: what its bodies sweep.
        first: where its bodies and its capsules begin there.
    """
    fleet, own, limits = scene.fleet, scene.own, scene.limits.entities
    around, box, other_box = own.box, own.body_box, other.body_box
    pairs, joint, entity = scene.pairs, scene.joint, scene.entity
    capsules, widest = scene.capsule_first, scene.widest
    b0, bodies = fleet.body_first[v], fleet.body_first[v + 1] - fleet.body_first[v]
    hulls = bodies_of(fleet, v)
    count = v * 0
    for k in range(bodies):
        x = first[0] + k
        if boxes_apart(around, ZERO, other_box, x, widest):
            continue
        low = first[1] + hulls.capsule_first[k]
        high = first[1] + hulls.capsule_first[k + 1]
        for o in range(len(box)):
            limit = limits[o, entity[b0 + k]]
            if (
                limit >= 0.0
                and not boxes_apart(box, o, other_box, x, limit)
                and (joint[o] >= 0 or hulls.joint[k] >= 0)
                and capsules_meet(
                    own, capsules[o], capsules[o + 1], other, low, high, limit
                )
            ):
                pairs[count] = o * bodies + k
                count += 1
    return count


@inner_kernel
def met_by_robots(
    scene: MoversScene, q0: Array, t0: float, q1: Array, t1: float
) -> float:
    """Return when a motion of one mover is in the way of other robots, infinity for never [s].

    Some places on it are looked at first, so it need not be the first such time.
    """
    q = np.empty_like(q0)
    if worth_probing(q0, t0, q1, t1):
        for share in (0.5, 0.25, 0.75):
            t = t0 + share * (t1 - t0)
            own_at(scene, q0, t0, q1, t1, t, q)
            sweep_between(scene, q, q, t, t)
            if not clear_of_tracks(scene, t, t):
                return t
    clear, until = moving_clear_until(scene, q0, t0, q1, t1)
    return np.inf if clear else until


@inner_kernel
def left_by_robots(scene: MoversScene, q: Array, t: float, latest: float) -> float:
    """Return from when on other robots leave room for the only mover to be at a place [s].

    Args:
        scene: the scene.
        q: the place, shape (n,).
        t: no earlier time is looked at [s].
        latest: nor a later one: some time after it may be returned though it is not free [s].
    """
    sweep_between(scene, q, q, t, t)
    around, widest, tracks = scene.own.box, scene.widest, scene.tracks
    start, end, box = tracks.pieces.start, tracks.pieces.end, tracks.sweeps.box
    waited = True
    while waited and t < latest:
        waited = False
        for r in range(len(tracks.first) - 1):
            last = tracks.first[r + 1]
            p, _ = pieces_at(start, end, tracks.first[r], last, t, t)
            while p < last and start[p] <= t + 1e-9 and t < latest:
                if boxes_apart(around, ZERO, box, p, widest):
                    break
                if clear_of_pieces(scene, p, p + 1, start[p], end[p]):
                    break
                t, waited = end[p], True
                p += 1
    return t


@inner_kernel
def worth_probing(q0: Array, t0: float, q1: Array, t1: float) -> bool:
    """Tell whether a motion is so long that places on it are looked at before all of it."""
    widest = t1 - t0
    for j in range(len(q0)):
        widest = max(widest, abs(q1[j] - q0[j]))
    return bool(widest > _PROBE)


@kernel
def clear_throughout(
    scene: MoversScene, q0: Array, q1: Array, lo: float, hi: float
) -> bool:
    """Tell whether a straight motion is clear of everything, wherever it is in a span.

    Args:
        scene: the scene.
        q0, q1: ends of the motion, shape (n,).
        lo, hi: the span [s].
    """
    clear, _ = still_clear_until(scene, q0, lo, q1, hi, hi - lo)
    if not clear:
        return False
    size = scene.step / (1 << scene.halvings)
    begin = np.floor(lo / size + 1e-6) * size
    finish = np.ceil(hi / size - 1e-6) * size
    sweep_between(scene, q0, q1, lo, hi)
    return clear_of_tracks(scene, begin, finish) and (
        len(scene.begin) == 1 or movers_clear(scene, hi >= lo)
    )


@kernel
def configuration_clear(scene: MoversScene, q: Array, t: float) -> bool:
    """Tell whether the movers may be at ``q``, shape (n,), at one instant."""
    clear, _ = still_clear_until(scene, q, t, q, t, 0.0)
    # The movers have been swept, if such it may be called, and not cut up.
    return (
        clear
        and clear_of_tracks(scene, t, t)
        and (len(scene.begin) == 1 or movers_clear(scene, clear))
    )


@inner_kernel
def clear_until(
    scene: MoversScene, q0: Array, t0: float, q1: Array, t1: float
) -> tuple[bool, float]:
    """Tell whether a whole motion is clear, and until when it is.

    Each mover that is free to move by then goes straight, at constant speed.

    Args:
        scene: the scene.
        q0, t0: where it begins, and when, shape (n,).
        q1, t1: where it ends, and when.
    """
    begins = scene.begin
    a, b = np.empty_like(q0), np.empty_like(q1)
    a[:] = q0
    begin = t0
    while begin < t1:
        # A mover that becomes free within the motion appears there.
        end = t1
        for m in range(len(begins)):
            if begin + 1e-9 < begins[m] < end:
                end = begins[m]
        own_at(scene, q0, t0, q1, t1, end, b)
        clear, until = still_clear_until(scene, a, begin, b, end, 0.0)
        if not clear:
            if until <= begin:
                return False, begin
            own_at(scene, q0, t0, q1, t1, until, b)
        moving, first = moving_clear_until(scene, a, begin, b, until)
        if not moving:
            return False, first
        if not clear:
            return False, until
        a[:] = b
        begin = end
    return True, t1


@kernel
def motion_clear(
    scene: MoversScene, q0: Array, t0: float, q1: Array, t1: float
) -> bool:
    """Tell whether a whole motion is clear: its end and its middle first."""
    if not configuration_clear(scene, q1, t1):
        return False
    if worth_probing(q0, t0, q1, t1):
        q, middle = np.empty_like(q0), 0.5 * (t0 + t1)
        own_at(scene, q0, t0, q1, t1, middle, q)
        if not configuration_clear(scene, q, middle):
            return False
    clear, _ = clear_until(scene, q0, t0, q1, t1)
    return bool(clear)
