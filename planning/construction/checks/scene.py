"""Scene of collision checks in compiled code: a robot, and all its static and moving obstacles."""

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
"""Greatest number of times that a cell of time is halved when robots are close."""


class StillBoxes(NamedTuple):
    """Boxes of fixtures and of objects at rest.

    Attributes:
        pose, half: pose and half edge lengths of each box, shapes (b, 4, 4) and (b, 3) [m].
        bounds: least and greatest coordinates of each box, shape (b, 6) [m].
        start, end: times between which the box is there, shape (b,) [s].
        hulls: hulls of the bodies in the boxes.
    """

    pose: Array
    half: Array
    bounds: Array
    start: Array
    end: Array
    hulls: HullTable


class Limits(NamedTuple):
    """Least distances of own bodies [m], SKIP for pairs that are not checked.

    Attributes:
        boxes: between own bodies and boxes, shape (o, b).
        entities: between bodies of two robots, by entity, shape (entities, entities).
        own: between own bodies, upper triangle, shape (o, o).
    """

    boxes: Array
    entities: Array
    own: Array


class Checks(NamedTuple):
    """Checks of a motion, each compiled once and shared by all callers.

    Attributes:
        still: whether the motion is clear of static obstacles, and the robot of itself.
        meeting: time up to which the motion is clear of moving robots.
        configuration: whether the robot is clear of everything at one instant.
        motion: whether the whole motion is clear of everything.
    """

    still: SharedKernel
    meeting: SharedKernel
    configuration: SharedKernel
    motion: SharedKernel


class MoverScene(NamedTuple):
    """A moving robot, its obstacles, and work arrays; one for each thread.

    Attributes:
        own: bodies of the robot and of the objects that it holds, swept along the last checked stretch.
        ends: work array for the ends of a stretch, shape (2, n).
        above: own bodies on the stretch, relative to a joint.
        fleet: the robot, then all other carriers.
        entity: entity number of each body, which is an index of ``limits.entities``, shape (bodies,).
        tracks: the other robots.
        boxes: boxes of static obstacles.
        limits: least distances.
        step: length of a cell of time [s].
        halvings: greatest number of times that a cell is halved when robots are close.
        widest: greatest of all least distances [m].
        other, other_room: volume swept by another carrier, and work arrays for it.
        near: work array for tracks or boxes near a motion.
        pairs: work array for pairs of bodies near each other.
        counting: the numbers 0, 1, 2, ...
        stack: stretches still to be checked, shape (256, 3).
        scratch: work arrays for distances between hulls.
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
        carriers: the moving robot, then those of the tracks.
        numbers: entity numbers by name.
        tracks: the other robots.
        boxes: boxes of static obstacles.
        limits: least distances.
        checks: compiled checks that other kernels call.
    """
    hulls = [carrier.hulls for carrier in carriers]
    most = max(h.q_a.shape[1] for h in hulls)
    bodies = max(len(h.joint) for h in hulls)
    capsules = max(len(h.radius) for h in hulls)
    corners = max(h.most_corners for h in [*hulls, boxes.hulls])
    own = make_swept(hulls[0])
    own.hulls.q_a[:] = np.nan  # no stretch swept yet
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
