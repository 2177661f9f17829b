"""How far the bodies of a robot can get between samples, from joint travel and lever arms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planning.transforms import Array, Indices
from twin.audit.worlds.world import JointAxes

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
    axes: JointAxes, samples: RobotSamples, link: int, centre: Array, radius: float
) -> Array:
    """Return how far any point of a body gets from sample to sample, whatever the way there.

    Joints move at constant speed between samples. A point moves no further than each joint's
    travel times its greatest distance from the joint's axis, added up. That distance is known at
    the samples; in between it changes by no more than the joints further out move the point.

    As seen from the base a second bound holds, which is nearer to the truth where joints move
    against each other: the way from one sample straight to the next, and half of the greatest
    change of velocity. So half of the way between the samples takes no more than half of the
    bound, and so on: it is one of speed.

    Args:
        axes: of the robot's joints.
        samples: m configurations of the robot.
        link: that the body moves with, 0 for the base.
        centre: of a sphere around the body at the samples, shape (m, 3) [m].
        radius: of the sphere [m].

    Returns:
        As seen from the base and each moved link up to ``link``, shape (m - 1, link + 1) [m].
    """
    out = np.zeros((len(centre) - 1, link + 1))
    if samples.distinct[0] == samples.distinct[-1]:  # it stands
        return out
    travel = np.abs(np.diff(samples.q, axis=0))
    turned = np.where(axes.prismatic, 0.0, travel)
    inside = np.cumsum(turned, axis=1) - turned
    change = np.zeros(len(out))
    for joint in range(link - 1, -1, -1):
        moved = travel[:, joint]
        if not axes.prismatic[joint]:
            axis = samples.rotation[:, joint + 1] @ axes.direction[joint]
            arm = centre - samples.position[:, joint + 1]
            along = np.einsum("ki,ki->k", arm, axis)
            square = np.einsum("ki,ki->k", arm, arm) - along * along
            lever = np.sqrt(np.maximum(square, 0.0))
            lever = np.minimum(lever[:-1], lever[1:]) + radius
            moved = moved * (lever + out[:, joint + 1])
        # Of velocities, each joint turns its own and those of the joints further out.
        change += moved * (turned[:, joint] + 2.0 * inside[:, joint])
        out[:, joint] = out[:, joint + 1] + moved
    straight = travel_of_points(samples.rotation[:, link], centre, radius)
    out[:, 0] = np.minimum(out[:, 0], straight + 0.5 * change + ROUNDING)
    return out


def travel_of_points(rotation: Array, centre: Array, radius: float) -> Array:
    """Return how far any point of a body gets, step by step, if it goes straight.

    Args:
        rotation: of the body at m samples, shape (m, 3, 3).
        centre: of a sphere around it, shape (m, 3) [m].
        radius: of the sphere [m].

    Returns:
        Upper bounds of the displacement of any point, shape (m - 1,) [m].
    """
    turned = np.diff(rotation, axis=0)
    # For rotations A and B the spectral norm of A - B is its Frobenius norm over sqrt(2).
    angle = np.sqrt(np.einsum("kij,kij->k", turned, turned) / 2.0)
    moved = np.linalg.norm(np.diff(centre, axis=0), axis=1)
    return np.asarray(moved + radius * angle)
