"""Bounds on the deviation of robot links when the flange deviates from its reference path in a skill.

The bounds are of first order. For a displaced and rotated flange, the joint values change by the least-norm
solution, computed with Jacobians of pinocchio, and the links move accordingly. No code is shared with planning.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from planning.cell.workcell import PoseError
from planning.transforms import Array, Indices
from scheduling.graph.temporal_plan_graph import NodeChain, TemporalPlanGraph
from scheduling.witness.parts import ConvexPart
from scheduling.witness.robot import WitnessRobot, inverses
from scheduling.witness.shapes import farthest_from

_BEYOND = 1.1
"""Safety factor of the first-order bounds, for the second order and for changes of the Jacobian in a piece."""

_LOST = 1e-6
"""Share of the largest singular value below which a direction counts as singular."""


def deviating_nodes(
    tpg: TemporalPlanGraph, chain: NodeChain, known: Mapping[str, PoseError]
) -> Array:
    """Return the allowed displacement and rotation of the flange in each node, shape (nodes, 2) [m, rad]."""
    of_task = {t.index: known[t.kind] for t in tpg.tasks if t.kind in known}
    out = np.zeros((len(chain), 2))
    for k in np.flatnonzero(chain.skill).tolist():
        if (off := of_task.get(int(chain.task[k]))) is not None:
            out[k] = off.m, off.rad
    return out


class DeviatingLinks:
    """The links of a robot in pieces of motion with a deviating flange.

    Args:
        robot: the robot.
        frames: of its base and joints at the knots of the pieces, shape (s + 1, n + 1, 4, 4).
        off: displacement and rotation of each piece, shape (s, 2) [m, rad].
    """

    def __init__(self, robot: WitnessRobot, frames: Array, off: Array) -> None:
        self._robot, self._off = robot, off
        self._pieces: Indices = np.flatnonzero(off.any(axis=1))
        both = np.concatenate([self._pieces, self._pieces + 1])
        self._frames = frames[both]
        joints = self._frames[:, 1:]
        slide = np.where(robot.turns[:, None], 0.0, robot.axes)
        turn = robot.axes - slide
        self._slides, self._turns = (
            (joints[..., :3, :3] @ part[..., None])[..., 0] for part in (slide, turn)
        )
        flange = (self._frames[:, -1] @ robot.flange)[:, :3, 3]
        self._follow = np.zeros((0, robot.dof, 6))
        if len(both):
            jacobian = np.concatenate([self._moves(flange), self._turns], axis=-1)
            self._follow = np.linalg.pinv(np.swapaxes(jacobian, 1, 2), rcond=_LOST)

    def deviates(self, part: ConvexPart) -> Array | None:
        """Return a bound on the deviation of any point of a part per piece, shape (s,) [m]; None for none."""
        if not len(self._pieces) or part.joint < 0:
            return None
        out, (m, rad) = np.zeros(len(self._off)), self._off[self._pieces].T
        if part.joint == self._robot.dof - 1:
            far = self._radius(part, self._robot.flange[:3, 3])
            out[self._pieces] = m + rad * far
            return out
        at = self._frames[:, part.joint + 1]
        middle = at[:, :3, :3] @ part.centre + at[:, :3, 3]
        own = slice(0, part.joint + 1)
        goes, spins = (
            np.swapaxes(of[:, own], 1, 2) @ self._follow[:, own]
            for of in (self._moves(middle), self._turns)
        )
        radius = self._radius(part, part.centre)
        of_way, of_turn = (
            (_largest(goes[..., k]) + radius * _largest(spins[..., k]))
            .reshape(2, -1)
            .max(axis=0)
            for k in (slice(0, 3), slice(3, 6))
        )
        out[self._pieces] = _BEYOND * (m * of_way + rad * of_turn)
        return out

    def _moves(self, points: Array) -> Array:
        """Return the translational Jacobians of points that all joints carry, shape (k, n, 3)."""
        arms = points[:, None] - self._frames[:, 1:, :3, 3]
        return np.asarray(self._slides + np.cross(self._turns, arms))

    def _radius(self, part: ConvexPart, place: Array) -> float:
        """Return the radius of a part around a position in its joint's frame [m]."""
        seen = inverses(part.local) @ np.append(place, 1.0)
        return float(farthest_from(part.shape, seen[None, :3])[0])


def _largest(maps: Array) -> Array:
    """Return the largest singular values of matrices, shape (k, 3, 3)."""
    return np.asarray(np.linalg.svd(maps, compute_uv=False)[:, 0])
