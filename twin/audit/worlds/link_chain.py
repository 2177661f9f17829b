"""Poses of a robot's links from a few that an engine measured.

An engine says where the links are at a few configurations and along which axes its joints move;
from that follow all others, many at a time. Where they do not follow, because a joint does not
carry the next one, the robot is left to the engine, one configuration after another.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from planning.transforms import Array


@dataclass(frozen=True)
class JointAxes:
    """The axes of a robot's joints.

    Attributes:
        direction: in the frame of the link that the joint moves, shape (n, 3).
        prismatic: shape (n,).
    """

    direction: Array
    prismatic: npt.NDArray[np.bool_]


Frames = tuple[Array, Array]
"""Rotations, shape (m, n + 1, 3, 3), and positions, shape (m, n + 1, 3): base, then links."""

_SAME = 1e-6
"""Links are where the engine puts them to within this [m per metre, and entries of rotations]:
Bullet rounds rotations by less than half of it."""

_TRIED = 16
"""Random configurations from which the chain is read off."""


@dataclass(frozen=True)
class LinkChain:
    """A robot whose joints follow one another, as an engine has measured it.

    Attributes:
        axes: of its joints.
        base: rotation and position of its base, shapes (3, 3) and (3,).
        turns: rotation of each link as seen from the one before, all joints at nought, shape
            (n, 3, 3).
        offsets: position likewise, shape (n, 3) [m].
    """

    axes: JointAxes
    base: tuple[Array, Array]
    turns: Array
    offsets: Array

    def frames(self, q: Array) -> Frames:
        """Return where the base and the links are at configurations, shape (m, n)."""
        count = len(self.offsets)
        rotation = np.empty((len(q), count + 1, 3, 3))
        position = np.empty((len(q), count + 1, 3))
        rotation[:, 0], position[:, 0] = self.base
        for j in range(count):
            before, axis = rotation[:, j], self.axes.direction[j]
            turn = before @ self.turns[j]
            position[:, j + 1] = position[:, j] + before @ self.offsets[j]
            if self.axes.prismatic[j]:
                position[:, j + 1] += (turn @ axis) * q[:, j, None]
                rotation[:, j + 1] = turn
            else:
                rotation[:, j + 1] = turn @ _turned(axis, q[:, j])
        return rotation, position


def measured_chain(
    axes: JointAxes, base: tuple[Array, Array], measure: Callable[[Array], Frames]
) -> LinkChain | None:
    """Return the chain of a robot, None where its joints do not follow one another.

    Args:
        axes: of its joints.
        base: rotation and position of its base.
        measure: returns what the engine says of configurations, shape (m, n).
    """
    count = len(axes.prismatic)
    tried = np.random.default_rng(0).uniform(-2.0, 2.0, (_TRIED, count))
    rotation, position = measure(tried)
    turns, offsets = np.empty((count, 3, 3)), np.empty((count, 3))
    for j in range(count):
        axis, back = axes.direction[j], rotation[:, j].transpose(0, 2, 1)
        turn = back @ rotation[:, j + 1]
        if not axes.prismatic[j]:
            turn = turn @ _turned(axis, -tried[:, j])
        turns[j] = _nearest_rotation(turn.mean(axis=0))
        way = np.einsum("mab,mb->ma", back, position[:, j + 1] - position[:, j])
        if axes.prismatic[j]:
            way = way - tried[:, j, None] * (turns[j] @ axis)
        offsets[j] = way.mean(axis=0)
    chain = LinkChain(axes, base, turns, offsets)
    own_rotation, own_position = chain.frames(tried)
    size = 1.0 + float(np.abs(position - position[:, :1]).max())
    same = (
        np.abs(own_rotation - rotation).max() <= _SAME
        and np.abs(own_position - position).max() <= _SAME * size
    )
    return chain if same else None


def _nearest_rotation(matrix: Array) -> Array:
    """Return the rotation that is nearest to a matrix, shape (3, 3)."""
    left, _, right = np.linalg.svd(matrix)
    return np.asarray(left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right)


def _turned(axis: Array, angle: Array) -> Array:
    """Return rotations about a unit axis, shape (m, 3, 3)."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    sine, rest = np.sin(angle)[:, None, None], 1.0 - np.cos(angle)[:, None, None]
    return np.asarray(np.eye(3) + sine * cross + rest * (cross @ cross))
