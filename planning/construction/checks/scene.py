"""Scenes: movers, what they sweep, and everything they may run into over time, for compiled code."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from planning.construction.world.timeline import STEP
from planning.construction.world.tracks import (
    Carrier,
    Fleet,
    Room,
    Sweeps,
    Tracks,
    bodies_of,
    make_fleet,
    no_sweeps,
    sweep_carrier,
)
from planning.geometry.hull_table import HullTable
from planning.geometry.separation import Scratch, room_for
from planning.kernels import inner_kernel
from planning.packed import packed
from planning.transforms import Array, Indices

HALVINGS = 3
"""How often a cell of time may be halved where robots are close."""


class StillBoxes(NamedTuple):
    """Fixtures, and objects where they lie.

    Attributes:
        pose, half: of each, shapes (b, 4, 4), (b, 3).
        bounds: least and greatest corner, shape (b, 6).
        start, end: when it is there, shape (b,) [s].
        number: 0, 1, 2, ..., shape (b,).
        hulls: the bodies.
    """

    pose: Array
    half: Array
    bounds: Array
    start: Array
    end: Array
    number: Indices
    hulls: HullTable


class Limits(NamedTuple):
    """Least distances of own bodies [m], SKIP where a pair is not checked.

    Attributes:
        boxes: to boxes, shape (o, b).
        entities: to bodies of other robots by entity, shape (o, entities).
        own: to each other, upper triangle, shape (o, o).
    """

    boxes: Array
    entities: Array
    own: Array


class MoversScene(NamedTuple):
    """Movers, what they must keep clear of, and room to work in: one for each thread.

    Attributes:
        fleet: movers, then all other carriers. The bodies of movers are called own bodies.
        entity: number by which limits speak of a body, shape (bodies,).
        begin: time from which on each mover moves; until then it is one of the tracks, shape
            (movers,) [s].
        joint_first: where the joints of a mover begin in a configuration, shape (movers + 1,).
        mover: of each own body, shape (o,).
        joint: that carries it, likewise.
        capsule_first: where its capsules begin in ``own``, shape (o + 1,).
        tracks: the other robots.
        boxes: what lies still.
        limits: least distances.
        step: cells of time begin at multiples of this [s].
        halvings: how often a cell may be halved where robots are close.
        widest: greatest of all least distances [m].
        q_a, q_b: ends of the stretch on which movers were swept last, shape (n,).
        own: what they sweep there, as one piece.
        moved: how far own capsules stray there, see ``place_capsules``.
        other, other_moved: likewise of some other carrier.
        near: tracks or boxes near a motion.
        pairs: pairs of bodies near each other.
        stack: stretches to be looked at, shape (256, 3).
        room: to sweep a carrier in.
        scratch: to compare hulls in.
    """

    fleet: Fleet
    entity: Indices
    begin: Array
    joint_first: Indices
    mover: Indices
    joint: Indices
    capsule_first: Indices
    tracks: Tracks
    boxes: StillBoxes
    limits: Limits
    step: float
    halvings: int
    widest: float
    q_a: Array
    q_b: Array
    own: Sweeps
    moved: Array
    other: Sweeps
    other_moved: Array
    near: Indices
    pairs: Indices
    stack: Array
    room: Room
    scratch: Scratch


def lay_out(
    carriers: Sequence[Carrier],
    numbers: Mapping[str, int],
    tracks: Tracks,
    boxes: StillBoxes,
    limits: Limits,
    begin: Array,
) -> MoversScene:
    """Return a scene. The carriers must outlive it.

    Args:
        carriers: movers, then those of the tracks.
        numbers: of all entities.
        tracks: the other robots.
        boxes: what lies still.
        limits: least distances.
        begin: when each mover is free to move, shape (movers,) [s].
    """
    hulls = [carrier.hulls for carrier in carriers]
    own = hulls[: len(begin)]
    most = max(h.q_a.shape[1] for h in hulls)
    bodies = max(len(h.joint) for h in hulls)
    capsules = max(len(h.radius) for h in hulls)
    corners = max(h.most_corners for h in [*hulls, boxes.hulls])
    own_bodies, own_capsules = (
        sum(len(h.joint) for h in own),
        sum(len(h.radius) for h in own),
    )
    joint_first = np.cumsum([0, *(h.q_a.shape[1] for h in own)])
    counts = np.concatenate([np.diff(h.capsule_first) for h in own])
    widest = max(0.0, *(float(t.max(initial=0.0)) for t in limits))
    names = [name for carrier in carriers for name in carrier.names]
    near = max(len(tracks.first), len(boxes.pose), 1)
    scene = MoversScene(
        make_fleet(carriers),
        np.array([numbers[name] for name in names], dtype=np.int64),
        begin,
        joint_first,
        np.repeat(np.arange(len(own)), [len(h.joint) for h in own]),
        np.concatenate([h.joint for h in own]),
        np.cumsum([0, *counts]),
        tracks,
        packed(boxes),
        packed(limits),
        STEP,
        HALVINGS,
        widest,
        np.zeros(int(joint_first[-1])),
        np.zeros(int(joint_first[-1])),
        packed(no_sweeps(np.array([own_bodies]), np.array([own_capsules]))),
        np.zeros((own_capsules, most + 1)),
        packed(no_sweeps(np.array([bodies]), np.array([capsules]))),
        np.zeros((capsules, most + 1)),
        np.zeros(near, dtype=np.int64),
        np.zeros(own_bodies * max(bodies, len(boxes.pose), 1), dtype=np.int64),
        np.zeros((256, 3)),
        packed(Room(np.zeros((most + 1, 4, 4)), np.zeros(most))),
        room_for(most, most, corners, corners),
    )
    return packed(scene)


@inner_kernel
def own_at(
    scene: MoversScene, q0: Array, t0: float, q1: Array, t1: float, t: float, out: Array
) -> None:
    """Write where the movers are at a time: each goes straight once it is free to move."""
    begins, joints = scene.begin, scene.joint_first
    for m in range(len(begins)):
        begin = max(t0, begins[m])
        if t <= begin and t < t1:
            share = 0.0
        elif t >= t1:
            share = 1.0 if begin < t1 or t0 >= t1 else 0.0
        else:
            share = (t - begin) / (t1 - begin)
        for j in range(joints[m], joints[m + 1]):
            out[j] = q1[j] if share == 1.0 else q0[j] + share * (q1[j] - q0[j])


@inner_kernel
def sweep_stretch(
    scene: MoversScene, q0: Array, t0: float, q1: Array, t1: float, lo: float, hi: float
) -> None:
    """Sweep the movers on the part from ``lo`` to ``hi`` of a motion; see ``own_at``."""
    own_at(scene, q0, t0, q1, t1, lo, scene.q_a)
    own_at(scene, q0, t0, q1, t1, hi, scene.q_b)
    _sweep(scene, lo, hi)


@inner_kernel
def sweep_between(
    scene: MoversScene, q0: Array, q1: Array, lo: float, hi: float
) -> None:
    """Sweep the movers from one configuration to another, both of shape (n,), in a span."""
    scene.q_a[:] = q0
    scene.q_b[:] = q1
    _sweep(scene, lo, hi)


@inner_kernel
def _sweep(scene: MoversScene, lo: float, hi: float) -> None:
    """Sweep the movers; those that are not free to move by then are nowhere."""
    joints, bodies = scene.joint_first, scene.fleet.body_first
    capsules, begin = scene.capsule_first, scene.begin
    own, box, around = scene.own, scene.own.body_box, scene.own.box
    for r in range(3):
        around[0, r] = np.inf
        around[0, r + 3] = -np.inf
    for m in range(len(begin)):
        b0, b1 = bodies[m], bodies[m + 1]
        if begin[m] > lo + 1e-9 and begin[m] >= hi - 1e-9:
            for o in range(b0, b1):
                for r in range(3):
                    box[o, r] = np.inf
                    box[o, r + 3] = -np.inf
            continue
        j0, j1, c0 = joints[m], joints[m + 1], capsules[b0]
        q_a, q_b = scene.q_a[j0:j1], scene.q_b[j0:j1]
        moved = scene.moved[c0 : capsules[b1]]
        hulls = bodies_of(scene.fleet, m)
        sweep_carrier(hulls, q_a, q_b, (b0, c0), own, moved, scene.room)
        for o in range(b0, b1):
            for r in range(3):
                around[0, r] = min(around[0, r], box[o, r])
                around[0, r + 3] = max(around[0, r + 3], box[o, r + 3])
