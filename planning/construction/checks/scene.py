"""Scenes for compiled code: a moving robot and all obstacles that it may meet over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from planning.construction.world.fleet import LoadedRobot, RobotFleet, make_fleet
from planning.construction.world.timeline import STEP
from planning.construction.world.tracks import Tracks
from planning.geometry.hull_table import HullTable
from planning.geometry.separation import Scratch, make_scratch_for
from planning.geometry.swept import (
    SweepRoom,
    Sweeps,
    SweptBodies,
    empty_sweeps,
    make_sweep_room,
    make_swept,
    sweep_bodies,
)
from planning.kernels import inner_kernel
from planning.packed import SharedKernel, packed
from planning.transforms import Array, Indices

HALVINGS = 3
"""How often a cell of time may be halved where robots are close."""


class StillBoxes(NamedTuple):
    """Boxes of fixtures and of objects at rest.

    Attributes:
        pose, half: of each, shapes (b, 4, 4), (b, 3).
        bounds: least and greatest corner, shape (b, 6).
        start, end: when it is there, shape (b,) [s].
        hulls: the bodies.
    """

    pose: Array
    half: Array
    bounds: Array
    start: Array
    end: Array
    hulls: HullTable


class Limits(NamedTuple):
    """Least distances of own bodies [m], SKIP where a pair is not checked.

    Attributes:
        boxes: to boxes, shape (o, b).
        entities: of two robots' bodies by entity, shape (entities, entities).
        own: to each other, upper triangle, shape (o, o).
    """

    boxes: Array
    entities: Array
    own: Array


class Checks(NamedTuple):
    """Checks of a motion, each compiled once and shared by all callers.

    Attributes:
        still: whether it is clear of static obstacles and of self-collision.
        meeting: time up to which it is clear of moving robots.
        configuration: whether the robot is clear of all obstacles at one instant.
        motion: whether the whole motion is clear of all obstacles.
    """

    still: SharedKernel
    meeting: SharedKernel
    configuration: SharedKernel
    motion: SharedKernel


class MoverScene(NamedTuple):
    """A moving robot, its obstacles, and work arrays; one for each thread.

    Attributes:
        own: its bodies and what it holds, swept along the stretch that was checked last.
        ends: work array for the ends of a stretch, shape (2, n).
        above: own bodies on the stretch, in the frame of a joint.
        fleet: the robot, then all other carriers.
        entity: index of each body in ``limits``, shape (bodies,).
        tracks: the other robots.
        boxes: boxes of static obstacles.
        limits: least distances.
        step: length of the time cells, which begin at its multiples [s].
        halvings: how often a cell may be halved where robots are close.
        widest: greatest of all least distances [m].
        other, other_room: work arrays for a piece of another carrier's swept volume.
        near: tracks or boxes near a motion.
        pairs: pairs of bodies near each other.
        counting: 0, 1, 2, ...
        stack: stretches to be checked, shape (256, 3).
        scratch: work array for comparing hulls.
        still, meeting, configuration, motion: see Checks.
    """

    own: SweptBodies
    ends: Array
    above: HullTable
    fleet: RobotFleet
    entity: Indices
    tracks: Tracks
    boxes: StillBoxes
    limits: Limits
    step: float
    halvings: int
    widest: float
    other: Sweeps
    other_room: SweepRoom
    near: Indices
    pairs: Indices
    counting: Indices
    stack: Array
    scratch: Scratch
    still: SharedKernel
    meeting: SharedKernel
    configuration: SharedKernel
    motion: SharedKernel


def make_scene(
    carriers: Sequence[LoadedRobot],
    numbers: Mapping[str, int],
    tracks: Tracks,
    boxes: StillBoxes,
    limits: Limits,
    checks: Checks,
) -> MoverScene:
    """Return a scene. The carriers must outlive it.

    Args:
        carriers: the robot that moves, then those of the tracks.
        numbers: of all entities.
        tracks: the other robots.
        boxes: boxes of static obstacles.
        limits: least distances.
        checks: that others ask for.
    """
    hulls = [carrier.hulls for carrier in carriers]
    most = max(h.q_a.shape[1] for h in hulls)
    bodies = max(len(h.joint) for h in hulls)
    capsules = max(len(h.radius) for h in hulls)
    corners = max(h.most_corners for h in [*hulls, boxes.hulls])
    own = make_swept(hulls[0])
    own.hulls.q_a[:] = np.nan  # swept nowhere yet
    pairs = len(hulls[0].joint) * max(bodies, len(boxes.pose))
    return packed(
        MoverScene(
            own,
            np.empty((2, hulls[0].q_a.shape[1])),
            hulls[0],
            make_fleet(carriers),
            np.concatenate([carrier.bodies.numbered(numbers) for carrier in carriers]),
            tracks,
            packed(boxes),
            packed(limits),
            STEP,
            HALVINGS,
            max(0.0, *(float(t.max(initial=0.0)) for t in limits)),
            packed(empty_sweeps([bodies], [capsules])),
            make_sweep_room(most, capsules),
            np.zeros(max(len(tracks.first), len(boxes.pose)), dtype=np.int64),
            np.zeros(pairs, dtype=np.int64),
            np.arange(max(bodies, len(boxes.pose))),
            np.zeros((256, 3)),
            make_scratch_for(most, most, corners, corners),
            *checks,
        )
    )


@inner_kernel
def interpolate_configuration(
    q0: Array, t0: float, q1: Array, t1: float, t: float, out: Array
) -> None:
    """Write the configuration at a time on the straight motion from (q0, t0) to (q1, t1)."""
    share = 1.0
    if t < t1:
        share = max(t - t0, 0.0) / (t1 - t0)
    for j in range(len(out)):
        out[j] = q1[j] if share == 1.0 else q0[j] + share * (q1[j] - q0[j])


@inner_kernel
def sweep_stretch(
    scene: MoverScene, q0: Array, t0: float, q1: Array, t1: float, lo: float, hi: float
) -> None:
    """Sweep the robot on the part from ``lo`` to ``hi`` of a motion; see ``interpolate_configuration``."""
    q_a, q_b, ends = scene.own.hulls.q_a[0], scene.own.hulls.q_b[0], scene.ends
    interpolate_configuration(q0, t0, q1, t1, lo, ends[0])
    interpolate_configuration(q0, t0, q1, t1, hi, ends[1])
    # A motion checked against static obstacles is often checked against robots next.
    known = True
    for j in range(len(q_a)):
        known = known and q_a[j] == ends[0, j] and q_b[j] == ends[1, j]
        q_a[j], q_b[j] = ends[0, j], ends[1, j]
    if not known:
        sweep_bodies(scene.own)
