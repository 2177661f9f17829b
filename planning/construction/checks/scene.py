"""Scenes: movers and everything they may run into over time, laid out for compiled code."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from planning.construction.world.fleet import Carrier, Fleet, make_fleet
from planning.construction.world.motion_pieces import STEP
from planning.construction.world.swept_track import Room, Sweeps, no_sweeps
from planning.construction.world.tracks import Tracks
from planning.geometry.hull_table import HullTable
from planning.geometry.separation import Scratch, room_for
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


class Scene(NamedTuple):
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
) -> Scene:
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
    scene = Scene(
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
