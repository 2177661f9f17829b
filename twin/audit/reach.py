"""How far the bodies of a robot can get between samples, from joint travel and lever arms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from planning.transforms import Array, Indices
from twin.audit.worlds.world import JointAxes


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
    travel = np.abs(np.diff(samples.q, axis=0))
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
        out[:, joint] = out[:, joint + 1] + moved
    return out
