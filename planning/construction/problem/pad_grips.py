"""Grips of a vacuum pad on the faces of a box."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from planning.construction.problem.problem import PartGrip
from planning.transforms import Array, readonly

FACES = ("+x", "-x", "+y", "-y", "+z", "-z")
"""The faces of a box, by the axis of its frame that points out of them."""


def face_grips(
    size: Array, faces: Sequence[str] = ("+z",), offsets: Sequence[float] = (0.0,)
) -> tuple[PartGrip, ...]:
    """Return grips on the faces of a box: the middle of each, or beside it.

    Args:
        size: edge lengths, shape (3,) [m].
        faces: which faces may be touched.
        offsets: distances from the middle along the longer edge of the face [m]; those that
            lie outside of it are left out.
    """
    grips = []
    for offset in offsets:
        for face in faces:
            axis, sign = "xyz".index(face[1]), 1.0 if face[0] == "+" else -1.0
            others = [k for k in range(3) if k != axis]
            along = max(others, key=lambda k: float(size[k]))
            if abs(offset) >= 0.5 * size[along]:
                continue
            touch = np.eye(4)
            touch[:3, :3] = _into(axis, sign, along)
            touch[axis, 3] = sign * 0.5 * size[axis]
            touch[along, 3] = offset
            beside = f" {offset * 1e3:+.0f} mm along {'xyz'[along]}" if offset else ""
            grips.append(PartGrip(readonly(touch), f"on {face}{beside}"))
    return tuple(grips)


def _into(axis: int, sign: float, along: int) -> Array:
    """Return tool axes: z into the face, x along its longer edge."""
    z, x = np.zeros(3), np.zeros(3)
    z[axis], x[along] = -sign, 1.0
    return np.column_stack([x, np.cross(z, x), z])
