"""Travel bounds of robot bodies between samples, from joint travel and lever arms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planning.transforms import Array, Indices
from scheduling.witness.robot import WitnessRobot

ROUNDING = 1e-7
"""Poses of links are rounded by less than this [m]."""


@dataclass(frozen=True)
class RobotSamples:
    """A robot during a stretch.

    Attributes:
        q: configurations, shape (m, n).
        distinct: number of the configuration at each sample; it rises when the robot has
            moved, shape (m,).
        rotation: of its base and moved links, shape (m, n + 1, 3, 3).
        position: likewise, shape (m, n + 1, 3) [m].
    """

    q: Array
    distinct: Indices
    rotation: Array
    position: Array


def motion_bounds(
    robot: WitnessRobot,
    samples: RobotSamples,
    links: Indices,
    centre: Array,
    radius: Array,
) -> Array:
    """Return travel bounds of all points of bodies between samples, for any path.

    Joints move at constant speed between samples. A point moves no further than each joint's
    travel times its greatest distance from the joint's axis, added up. That distance is known at
    the samples; in between it changes by no more than the joints further out move the point.

    As seen from the base a second bound holds, which is nearer to the truth where joints move
    against each other: the way from one sample straight to the next, and half of the greatest
    change of velocity. So half of the way between the samples takes no more than half of the
    bound, and so on: it is one of speed.

    Args:
        robot: whose joints carry them.
        samples: m configurations of the robot.
        links: that each of s bodies moves with, 0 for the base, shape (s,).
        centre: of a sphere around each body at the samples, shape (m, s, 3) [m].
        radius: of the spheres, shape (s,) [m].

    Returns:
        As seen from the base and each moved link, shape (m - 1, s, n + 1); nought as seen from
        the link of a body, and from those further out [m].
    """
    count, joints = len(centre), robot.dof
    out = np.zeros((count - 1, len(links), joints + 1))
    if samples.distinct[0] == samples.distinct[-1] or not len(links):  # it stands
        return out
    travel = np.abs(np.diff(samples.q, axis=0))
    turned = np.where(robot.turns, travel, 0.0)
    inside = np.cumsum(turned, axis=1) - turned
    change = np.zeros((count - 1, len(links)))
    for joint in range(int(links.max()) - 1, -1, -1):
        carried = np.flatnonzero(links > joint)
        moved = np.repeat(travel[:, joint, None], len(carried), axis=1)
        beyond = out[:, carried, joint + 1]
        if robot.turns[joint]:
            axis = samples.rotation[:, joint + 1] @ robot.axes[joint]
            arm = centre[:, carried] - samples.position[:, None, joint + 1]
            along = np.einsum("msi,mi->ms", arm, axis)
            square = np.einsum("msi,msi->ms", arm, arm) - along * along
            lever = np.sqrt(np.maximum(square, 0.0))
            lever = np.minimum(lever[:-1], lever[1:]) + radius[carried]
            moved = moved * (lever + beyond)
        # Of velocities, each joint turns its own and those of the joints further out.
        turns = turned[:, joint] + 2.0 * inside[:, joint]
        change[:, carried] += moved * turns[:, None]
        out[:, carried, joint] = beyond + moved
    straight = np.sqrt(np.sum(np.diff(centre, axis=0) ** 2, axis=2))
    straight += radius * rotation_travel(samples.rotation)[:, links]
    out[:, :, 0] = np.minimum(out[:, :, 0], straight + 0.5 * change + ROUNDING)
    return out


def travel_of_points(rotation: Array, centre: Array, radius: float) -> Array:
    """Return travel bounds of any point of a body per step, for straight motion.

    Args:
        rotation: of the body at m samples, shape (m, 3, 3).
        centre: of a sphere around it, shape (m, 3) [m].
        radius: of the sphere [m].

    Returns:
        Upper bounds of the displacement of any point, shape (m - 1,) [m].
    """
    moved = np.linalg.norm(np.diff(centre, axis=0), axis=1)
    return np.asarray(moved + radius * rotation_travel(rotation))


def rotation_travel(rotation: Array) -> Array:
    """Return travel bounds of points at distance 1 per step, for straight motion.

    Args:
        rotation: of bodies at m samples, shape (m, ..., 3, 3).

    Returns:
        Upper bounds, shape (m - 1, ...).
    """
    turned = np.diff(rotation, axis=0)
    # For rotations A and B the spectral norm of A - B is its Frobenius norm over sqrt(2).
    return np.asarray(np.sqrt(np.einsum("...ij,...ij->...", turned, turned) / 2.0))
