"""Volumes of pieces of robot motions, as capsules at sampled configurations, and tests for overlaps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from planning.cell.workcell import Workcell
from planning.geometry.distance import segment_segment
from planning.geometry.hull_table import HullTable
from planning.geometry.robot_bodies import robot_bodies
from planning.kernels import inner_kernel, kernel
from planning.kinematics.chain import pose_joints
from planning.packed import packed
from planning.transforms import Array, Indices

SAMPLES = 3
"""Number of sampled configurations per piece of a motion."""

MARGIN = 0.01
"""Distance added to the clearance, for the motion between the samples and for loads [m]."""

_UNKNOWN = -1


class Volumes(NamedTuple):
    """Volumes, for compiled code.

    Attributes:
        first: index of the first capsule of each volume, shape (v + 1,).
        ends: starts and ends of the capsules in the world, shape (all, 2, 3) [m].
        radius: their radii, including half the distance to keep, shape (all,) [m].
        box: bounds of each volume, shape (v, 6) [m].
        known: whether two volumes meet; -1 if that is not computed yet, shape (v, v).
    """

    first: Indices
    ends: Array
    radius: Array
    box: Array
    known: np.ndarray


def build_volumes(
    cell: Workcell, robots: Sequence[str], pieces: Sequence[Array]
) -> Volumes:
    """Return the volumes of pieces of motions, given the robot and the configurations of each, shape (SAMPLES, n)."""
    keep = 0.5 * (cell.clearances.robot_robot + MARGIN)
    tables = {robot.name: robot_bodies(robot).hulls for robot in cell.robots}
    sizes = [SAMPLES * len(tables[name].radius) for name in robots]
    first = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
    found = packed(
        Volumes(
            first,
            np.empty((first[-1], 2, 3)),
            np.empty(first[-1]),
            np.repeat([[np.inf, -np.inf]], 3, axis=1).repeat(len(pieces), axis=0),
            np.full((len(pieces), len(pieces)), _UNKNOWN, dtype=np.int8),
        )
    )
    for name, table in tables.items():
        own = [k for k, robot in enumerate(robots) if robot == name]
        if own:
            stacked = np.array([pieces[k] for k in own])
            place_volumes(table, stacked, np.array(own), keep, found)
    return found


@kernel
def place_volumes(
    hulls: HullTable, pieces: Array, numbers: Indices, keep: float, volumes: Volumes
) -> None:
    """Write the capsules of a robot on pieces of its motions, and their bounds.

    Args:
        hulls: the bodies of the robot.
        pieces: configurations of each, shape (p, s, n).
        numbers: of their volumes, shape (p,).
        keep: half the distance to keep [m].
        volumes: written here, with empty bounds.
    """
    poses = np.empty((pieces.shape[2] + 1, 4, 4))
    own, joint, first = hulls.ends, hulls.joint, hulls.capsule_first
    for p in range(len(numbers)):
        out, box = volumes.first[numbers[p]], volumes.box[numbers[p]]
        for k in range(pieces.shape[1]):
            pose_joints(hulls.robot, pieces[p, k], poses)
            for body in range(len(joint)):
                at = joint[body] + 1
                for c in range(first[body], first[body + 1]):
                    thick = hulls.radius[c] + keep
                    volumes.radius[out] = thick
                    for e in range(2):
                        for r in range(3):
                            value = poses[at, r, 3]
                            for i in range(3):
                                value += poses[at, r, i] * own[c, e, i]
                            volumes.ends[out, e, r] = value
                            box[r] = min(box[r], value - thick)
                            box[r + 3] = max(box[r + 3], value + thick)
                    out += 1


@inner_kernel
def do_volumes_meet(volumes: Volumes, a: int, b: int) -> bool:
    """Tell whether two volumes meet."""
    known = volumes.known
    if known[a, b] < 0:
        meets = _search_contact(volumes, a, b)
        known[a, b] = known[b, a] = 1 if meets else 0
    return bool(known[a, b] == 1)


@inner_kernel
def _search_contact(volumes: Volumes, a: int, b: int) -> bool:
    first, ends = volumes.first, volumes.ends
    radius, box = volumes.radius, volumes.box
    for r in range(3):
        if box[a, r] > box[b, r + 3] or box[b, r] > box[a, r + 3]:
            return False
    for i in range(first[a], first[a + 1]):
        thick = radius[i]
        outside = False
        for r in range(3):
            low = min(ends[i, 0, r], ends[i, 1, r]) - thick
            high = max(ends[i, 0, r], ends[i, 1, r]) + thick
            if low > box[b, r + 3] or box[b, r] > high:
                outside = True
        if outside:
            continue
        for j in range(first[b], first[b + 1]):
            near = thick + radius[j]
            apart = segment_segment(ends[i, 0], ends[i, 1], ends[j, 0], ends[j, 1])
            if apart < near * near:
                return True
    return False
