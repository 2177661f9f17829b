"""The robot arm of the published APEX-MR files: comparison with the robot model, tool frames, base poses."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

import numpy as np

from planning.errors import ScenarioError
from planning.files import read_file
from planning.transforms import Array, Transform, inverse

_PI = np.pi
# Denavit-Hartenberg parameters of the published arm up to the flange, by joint: theta offset, d, a, alpha.
_GP4 = np.array(
    [
        [0.0, 0.0, 0.0, -_PI / 2],
        [-_PI / 2, 0.0, 0.26, _PI],
        [0.0, 0.0, 0.015, -_PI / 2],
        [0.0, -0.29, 0.0, _PI / 2],
        [0.0, 0.0, 0.0, -_PI / 2],
        [0.0, -0.072, 0.0, _PI],
    ]
)


def check_arm(properties: Path) -> None:
    """Check that the published arm is the same as that of the model ``gp4``.

    Raises:
        ScenarioError: its Denavit-Hartenberg table differs.
    """
    path = properties / "gp4_DH.txt"
    if not np.allclose(_table(path, (6, 4)), _GP4, atol=1e-6):
        raise ScenarioError(f"{path}: describes another arm than the model 'gp4'")


def tool_offset(properties: Path, robot: str, tool: str) -> list[float]:
    """Return the origin of a tool frame in the flange frame [m].

    A robot has a table of its own, or shares that of all arms. Tables differ in their last row
    only, d and a of the tool. As that row ends with a half turn about x, a frame with (d, a) lies
    at (a, 0, d_flange - d) in the flange frame, with the same axes.

    Args:
        properties: the folder ``robot_properties``.
        robot: such as ``"r1"``.
        tool: a value of TOOLS.

    Raises:
        ScenarioError: there is no table, or it is not that of the same arm with another tool.
    """
    names = [f"{owner}_{tool}_DH.txt" for owner in (robot, "gp4")]
    path = next((properties / k for k in names if (properties / k).exists()), None)
    if path is None:
        raise ScenarioError(
            f"{properties}: has no table of the tool frame {tool!r} for robot {robot!r}: "
            f"neither {' nor '.join(names)}",
            choices=tuple(sorted(p.name for p in properties.glob("*_DH.txt"))),
        )
    table = _table(path, (6, 4))
    rest = table.copy()
    rest[5, 1:3] = _GP4[5, 1:3]
    if not np.allclose(rest, _GP4, atol=1e-6):
        raise ScenarioError(f"{path}: differs from gp4_DH.txt in more than the tool")
    return [float(table[5, 2]), 0.0, float(_GP4[5, 1] - table[5, 1])]


def arm_base(properties: Path, file: str | None) -> Transform:
    """Return the pose of a robot's base in the world.

    Published bases are those of the shoulder; ``gp4_base.txt`` is the shoulder in the base.

    Args:
        properties: the folder ``robot_properties``.
        file: name of the robot's file, None for the frame that the plates are given in.
    """
    world = _matrix(properties / "world_base.txt")
    if file is None:
        return world
    shoulder = _matrix(properties / "gp4_base.txt")
    return world @ _matrix(properties / file) @ inverse(shoulder)


def _matrix(path: Path) -> Transform:
    pose = _table(path, (4, 4))
    if not np.allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-6):
        raise ScenarioError(f"{path}: is not a rigid transform")
    return pose


def _table(path: Path, shape: tuple[int, int]) -> Array:
    try:
        table = np.loadtxt(BytesIO(read_file(path)), dtype=np.float64)
    except OSError as error:
        raise ScenarioError(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise ScenarioError(f"{path}: {error}") from None
    if table.shape != shape:
        raise ScenarioError(
            f"{path}: has shape {table.shape}, must have {shape[0]} rows of {shape[1]}"
        )
    return np.asarray(table, dtype=np.float64)
