"""Tables of moving convex hulls: arrays for compiled code."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from planning.geometry.exact import Solid
from planning.kernels import inner_kernel
from planning.kinematics.chain import JointTable, empty_chain_table
from planning.packed import packed
from planning.transforms import Array, Indices

AT_REST = -2
"""Placeholder for the joint of a body that rests in the world."""


class HullTable(NamedTuple):
    """The bodies of an occupancy (the space that a robot sweeps), as arrays for compiled code.

    Attributes:
        robot: joints of the robot.
        q_a, q_b: ends of the segments, shape (s, n).
        solid: index of the solid of every body of every segment, -1 for none, shape
            (s, bodies).
        joint: joint that carries a solid, -1 for the base, AT_REST for none, shape (solids,).
        corner_first: where the corners of a solid begin, shape (solids + 1,).
        corners: hull corners in the joint's frame, or in the world, shape (all, 3) [m].
        capsule_first: where the capsules of a solid begin, shape (solids + 1,).
        ends: capsule starts and ends in the same frame, shape (capsules, 2, 3) [m].
        radius: capsule radii, shape (capsules,) [m].
        deviates: how far any point of a solid may be from where joints have it, shape (solids,) [m].
        most_corners: most corners of a solid.
    """

    robot: JointTable
    q_a: Array
    q_b: Array
    solid: npt.NDArray[np.int32]
    joint: Indices
    corner_first: Indices
    corners: Array
    capsule_first: Indices
    ends: Array
    radius: Array
    deviates: Array
    most_corners: int

    def on_a_motion(self) -> HullTable:
        """Return the same bodies on one segment of their own."""
        n = self.q_a.shape[1]
        return packed(self._replace(q_a=np.zeros((1, n)), q_b=np.zeros((1, n))))

    def seen_from_base(self) -> HullTable:
        """Return the same bodies relative to their own robot's base, without its error."""
        if not (self.robot.error.any() or self.deviates.any()):
            return packed(self)
        robot = packed(self.robot._replace(error=np.zeros(2)))
        none = np.zeros_like(self.deviates)
        return packed(self._replace(robot=robot, deviates=none))


def hull_table(
    robot: JointTable,
    q_a: Array,
    q_b: Array,
    solid: npt.NDArray[np.int32],
    solids: Sequence[Solid],
) -> HullTable:
    """Collect bodies for compiled code.

    Args:
        robot: joints of the robot that carries them.
        q_a, q_b: ends of the segments, shape (s, n).
        solid: index of the solid of every body of every segment, shape (s, bodies).
        solids: the bodies.
    """
    # There may be no bodies at all: a robot alone in an empty cell.
    corners = [np.empty((0, 3)), *(s.vertices for s in solids)]
    ends = [np.empty((0, 2, 3)), *(s.ends for s in solids)]
    radius = [np.empty(0), *(s.body.capsules.radius for s in solids)]
    joint = [AT_REST if s.carrier is None else s.joint for s in solids]
    table = HullTable(
        robot,
        q_a,
        q_b,
        solid,
        np.array(joint, dtype=np.int64),
        np.cumsum([len(c) for c in corners]).astype(np.int64),
        np.concatenate(corners),
        np.cumsum([len(e) for e in ends]).astype(np.int64),
        np.concatenate(ends),
        np.concatenate(radius),
        np.array([s.deviates for s in solids], dtype=np.float64),
        max(map(len, corners)),
    )
    return packed(table)


def standing_hulls(solids: Sequence[Solid]) -> HullTable:
    """Collect bodies that rest in the world."""
    q, which = np.empty((1, 0)), np.arange(len(solids), dtype=np.int32)[None]
    return hull_table(empty_chain_table(), q, q, which, solids)


@inner_kernel
def place_corners(
    table: HullTable, solid: int, poses: Array, out: Array, offset: int
) -> int:
    """Write the corners of a body in the world from row ``offset`` on; return the next free row."""
    first, last = table.corner_first[solid], table.corner_first[solid + 1]
    corners, p = table.corners, table.joint[solid] + 1
    end = offset + last - first
    if p <= AT_REST + 1:
        for v in range(first, last):
            for r in range(3):
                out[offset + v - first, r] = corners[v, r]
        return int(end)
    for v in range(first, last):
        x, y, z = corners[v, 0], corners[v, 1], corners[v, 2]
        for r in range(3):
            out[offset + v - first, r] = (
                poses[p, r, 0] * x
                + poses[p, r, 1] * y
                + poses[p, r, 2] * z
                + poses[p, r, 3]
            )
    return int(end)
