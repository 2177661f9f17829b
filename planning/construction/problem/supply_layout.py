"""Layout of the supply of a construction: poses of parts before they are picked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias, Union

import numpy as np
from scipy.optimize import linear_sum_assignment

from planning.construction.problem.models import ModelPart
from planning.transforms import Transform, read_only_copy, rotation, translation

SupplyLayout: TypeAlias = Union["Spiral", "Rows"]
"""Layout of the parts before they are picked."""


@dataclass(frozen=True)
class Spiral:
    """Parts on a spiral around the site, the first ones innermost.

    The defaults are those of Hartmann et al.: part i lies at radius 3 + 0.05 i m and angle
    i / 2 rad.

    Attributes:
        radius: of the first part [m].
        growth: how much further out each next part lies [m].
        turn: angle from one part to the next; an even share of a full turn leaves straight
            lanes between the parts, from the outside to the site [rad].
        across: whether parts lie with their longer edge across the radius, not along it.
        high: parts of a stack, the first ones on top.
    """

    radius: float = 3.0
    growth: float = 0.05
    turn: float = 0.5
    across: bool = False
    high: int = 1

    def spots(self, count: int) -> list[Transform]:
        """Return a pose on the ground for each stack; x points away from the site's middle.

        Where they lie across the radius, y points towards it instead.
        """
        turn = rotation("z", 0.5 * np.pi if self.across else 0.0)
        return [
            rotation("z", k * self.turn)
            @ translation(self.radius + k * self.growth, 0.0, 0.0)
            @ turn
            for k in range(count)
        ]


@dataclass(frozen=True)
class Rows:
    """Parts in rows on one side of the site, the first ones nearest to it.

    Attributes:
        first: middle of the first row on the ground, x and y [m].
        columns: parts of a row.
        pitch: distance of parts in a row, and of rows [m].
        yaw: direction in which further rows lie [rad].
        high: parts of a stack, the first ones on top.
    """

    first: tuple[float, float]
    columns: int
    pitch: tuple[float, float]
    yaw: float = 0.0
    high: int = 1

    def spots(self, count: int) -> list[Transform]:
        """Return a pose on the ground for each stack; x points along ``yaw``."""
        frame = translation(self.first[0], self.first[1], 0.0) @ rotation("z", self.yaw)
        out = []
        for k in range(count):
            row, column = divmod(k, self.columns)
            side = (column - 0.5 * (self.columns - 1)) * self.pitch[0]
            out.append(frame @ translation(row * self.pitch[1], side, 0.0))
        return out


def supply_poses(
    parts: Sequence[ModelPart], layout: SupplyLayout, *, near: bool = False
) -> dict[str, Transform]:
    """Return the start pose of every part: flat, its first face up.

    Args:
        parts: the model.
        layout: the spots.
        near: whether every stack lies near the place where its parts belong, as far as others
            leave it room; by default they lie in their order.
    """
    stacks = [parts[k : k + layout.high] for k in range(0, len(parts), layout.high)]
    spots = layout.spots(len(stacks))
    if near and parts:
        spots = [spots[k] for k in _nearest(stacks, spots)]
    out: dict[str, Transform] = {}
    for stack, spot in zip(stacks, spots, strict=True):
        height = 0.0
        for part in reversed(stack):
            flat = pose_on_ground(part)
            out[part.name] = read_only_copy(spot @ translation(0.0, 0.0, height) @ flat)
            height += 2.0 * float(flat[2, 3])
    return out


def _nearest(
    stacks: Sequence[Sequence[ModelPart]], spots: Sequence[Transform]
) -> list[int]:
    """Return the spot of each stack: the assignment with the least sum of squared distances to the goals."""
    at = np.array([spot[:2, 3] for spot in spots])
    to = np.array([np.mean([p.goal[:2, 3] for p in s], axis=0) for s in stacks])
    away = np.sum((to[:, None] - at[None]) ** 2, axis=2)
    chosen = linear_sum_assignment(away)[1]
    return [int(k) for k in chosen]


def pose_on_ground(part: ModelPart) -> Transform:
    """Return the pose of a part on the ground with its first face up.

    The longer edge of that face points along the x axis of its spot.
    """
    face = part.faces[0]
    up, sign = "xyz".index(face[1]), 1.0 if face[0] == "+" else -1.0
    along = max((k for k in range(3) if k != up), key=lambda k: float(part.size[k]))
    axes = np.zeros((3, 3))
    axes[along, 0], axes[up, 2] = 1.0, sign
    axes[:, 1] = np.cross(axes[:, 2], axes[:, 0])
    pose = translation(0.0, 0.0, 0.5 * float(part.size[up]))
    pose[:3, :3] = axes.T
    return pose
