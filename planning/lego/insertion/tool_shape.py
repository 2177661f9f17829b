"""Shape of a LEGO tool for sequencing: the collision bodies of the robot that carries it.

A tool is described once, in the URDF file of its robot. Here its convex bodies, those of the
force sensor behind it among them, are cut across where they taper, so that a box around each
piece is a close one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np

from planning.cell.cover import cut_across
from planning.robots.registry import robot_model
from planning.transforms import Array, Transform, inverse, readonly

_THICK = 0.0045
"""Pieces of a tapering body are no thicker than this along the tool [m]."""

_SAME = 1e-6
"""Corners at the same height, or above each other, to within this [m]."""


@dataclass(frozen=True)
class ToolShape:
    """A LEGO tool in its frame ``"tool"``.

    That frame has z out of the tool, the origin in the grip plane, and x towards the middle of a
    brick gripped from above.

    Attributes:
        frames: tool frames in the flange frame.
        pieces: corners of the convex pieces, the last one of each repeated to fill its row,
            shape (m, v, 3) [m].
        tip: least and greatest corner of the part that grips, shape (2, 3) [m].
        lever_end: likewise of the end of the wall beside the grip.
    """

    frames: Mapping[str, Transform]
    pieces: Array
    tip: Array
    lever_end: Array

    def boxes_at(self, pose: Transform) -> Array:
        """Return boxes along the world's axes around the pieces, shape (m, 2, 3) [m].

        Args:
            pose: of the frame ``"tool"``.
        """
        corners = self.pieces @ pose[:3, :3].T + pose[:3, 3]
        return np.stack([corners.min(axis=1), corners.max(axis=1)], axis=1)


@cache
def tool_shape(robot: str = "gp4") -> ToolShape:
    """Return the shape of the LEGO tool of a registered robot.

    Args:
        robot: its name.
    """
    model = robot_model(robot)
    to_tool = inverse(model.flange @ model.frames["tool"])
    bodies = [
        part.body.vertices @ to_tool[:3, :3].T + to_tool[:3, 3]
        for part in model.parts
        if part.joint == model.dof - 1
    ]
    pieces = [piece for corners in bodies for piece in _cut(corners)]
    most = max(map(len, pieces))
    rows = [np.vstack([p, np.repeat(p[-1:], most - len(p), axis=0)]) for p in pieces]
    # The tip ends in the grip plane, the lever beyond it.
    lever = max(bodies, key=lambda corners: float(corners[:, 2].max()))
    tip = min(bodies, key=lambda corners: abs(float(corners[:, 2].max())))
    end = lever[lever[:, 2] > lever[:, 2].max() - _SAME]
    return ToolShape(model.frames, readonly(rows), _box(tip), _box(end))


def _box(corners: Array) -> Array:
    return readonly([corners.min(axis=0), corners.max(axis=0)])


def _cut(corners: Array) -> list[Array]:
    """Cut a convex body across where it tapers."""
    z = corners[:, 2]
    low, high = (corners[np.abs(z - end) < _SAME, :2] for end in (z.min(), z.max()))
    same = np.allclose(
        [low.min(axis=0), low.max(axis=0)],
        [high.min(axis=0), high.max(axis=0)],
        rtol=0.0,
        atol=_SAME,
    )
    count = 1 if same else int(np.ceil(np.ptp(z) / _THICK))
    return cut_across(corners, 2, count)
