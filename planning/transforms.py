"""Rigid transforms as 4 x 4 homogeneous matrices, metres and radians."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

Transform = npt.NDArray[np.float64]
"""A (4, 4) homogeneous transform; ``parent_T_child`` maps child coordinates to the parent's."""

Array = npt.NDArray[np.float64]

Indices = npt.NDArray[np.int64]

_IDENTITY = np.eye(4)
"""Template of new transforms; a copy takes half the time of a new matrix."""


def identity() -> Transform:
    """Return the identity transform."""
    return _IDENTITY.copy()


def translation(x: float, y: float, z: float) -> Transform:
    """Return a pure translation [m]."""
    out = _IDENTITY.copy()
    out[:3, 3] = (x, y, z)
    return out


def rotation(axis: str, angle: float) -> Transform:
    """Return a rotation about a coordinate axis.

    Args:
        axis: ``"x"``, ``"y"`` or ``"z"``.
        angle: angle [rad].
    """
    i = "xyz".index(axis)
    a, b = (i + 1) % 3, (i + 2) % 3
    c, s = np.cos(angle), np.sin(angle)
    out = _IDENTITY.copy()
    out[a, a] = out[b, b] = c
    out[a, b], out[b, a] = -s, s
    return out


def from_rpy(xyz: Sequence[float] | Array, rpy: Sequence[float] | Array) -> Transform:
    """Return translation ``xyz`` [m] after R = Rz(yaw) Ry(pitch) Rx(roll) [rad]."""
    out = rotation("z", rpy[2]) @ rotation("y", rpy[1]) @ rotation("x", rpy[0])
    out[:3, 3] = xyz
    return out


def from_quat_wxyz(xyz: Sequence[float], quat: Sequence[float]) -> Transform:
    """Return the transform of a translation [m] and a quaternion (w, x, y, z), normalised here."""
    w, x, y, z = np.asarray(quat, dtype=float) / np.linalg.norm(quat)
    out = _IDENTITY.copy()
    out[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    out[:3, 3] = xyz
    return out


def quat_wxyz(pose: Transform) -> Array:
    """Return the unit quaternion (w, x, y, z) of a transform's rotation, with w >= 0."""
    m = pose[:3, :3]
    x, y, z = m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]
    xy, xz, yz = m[0, 1] + m[1, 0], m[0, 2] + m[2, 0], m[1, 2] + m[2, 1]
    # Four times each product of two components, such as w * x.
    products = np.array(
        [
            [1 + m[0, 0] + m[1, 1] + m[2, 2], x, y, z],
            [x, 1 + m[0, 0] - m[1, 1] - m[2, 2], xy, xz],
            [y, xy, 1 - m[0, 0] + m[1, 1] - m[2, 2], yz],
            [z, xz, yz, 1 - m[0, 0] - m[1, 1] + m[2, 2]],
        ]
    )
    # The largest of the four squared components is at least 1/4: divide by that one.
    k = int(np.argmax(np.diagonal(products)))
    quat = products[k] * (0.5 / np.sqrt(products[k, k]))
    return np.asarray(quat if quat[0] >= 0 else -quat)


def frame_along(direction: Array) -> Array:
    """Return a rotation whose third row is a direction, shape (3, 3)."""
    across = np.cross(direction, np.eye(3)[np.abs(direction).argmin()])
    across /= np.linalg.norm(across)
    return np.array([across, np.cross(direction, across), direction])


def inverse(pose: Transform) -> Transform:
    """Return the inverse of a rigid transform."""
    out = _IDENTITY.copy()
    out[:3, :3] = pose[:3, :3].T
    out[:3, 3] = -pose[:3, :3].T @ pose[:3, 3]
    return out


def read_only_copy(values: npt.ArrayLike) -> Array:
    """Return a float copy that cannot be written to."""
    out = np.array(values, dtype=np.float64)
    out.setflags(write=False)
    return out
