"""The JSON and text files of the APEX-MR authors, read with errors that name file and key."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from planning.errors import ScenarioError
from planning.transforms import Array, Transform, inverse

TOOL_FILES: Mapping[str, str] = {
    "tool": "gp4_tool_DH.txt",
    "assemble": "gp4_tool_assemble_DH.txt",
    "disassemble": "gp4_tool_disassemble_DH.txt",
    "handover_assemble": "gp4_tool_handover_assemble_DH.txt",
    "alt": "gp4_tool_alt_DH.txt",
    "alt_assemble": "gp4_tool_alt_assemble_DH.txt",
}
"""Published file of each tool frame."""

_PI = np.pi
# Rows (theta offset, d, a, alpha) of the arm whose tasks are published, up to the flange.
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


@dataclass(frozen=True)
class Record:
    """A JSON object with the place it comes from.

    Attributes:
        path: the file.
        key: key of the object in the file, empty for the whole file.
        content: the object.
    """

    path: Path
    key: str
    content: Mapping[str, Any]

    def where(self, key: str) -> str:
        """Return file and key for a message."""
        return f"{self.path}: {'.'.join(k for k in (self.key, key) if k)}"

    def child(self, key: str) -> Record:
        """Return the object at ``key``."""
        value = _get(self, key)
        if not isinstance(value, dict):
            raise ScenarioError(f"{self.where(key)}: must be an object")
        return Record(self.path, ".".join(k for k in (self.key, key) if k), value)


def read_json(path: Path) -> Record:
    """Return the object that a JSON file holds.

    Raises:
        ScenarioError: there is no such file, or it does not hold an object.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ScenarioError(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise ScenarioError(f"{path}: is not valid JSON: {error}") from None
    if not isinstance(content, dict):
        raise ScenarioError(f"{path}: must hold an object")
    return Record(path, "", content)


def number(record: Record, key: str) -> float:
    """Return a finite number."""
    value = _get(record, key)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ScenarioError(f"{record.where(key)}: {value!r} is not a number")
    if not np.isfinite(value):
        raise ScenarioError(f"{record.where(key)}: {value!r} is not finite")
    return float(value)


def integer(record: Record, key: str, *, default: int | None = None) -> int:
    """Return a whole number, or the default where the key is missing and there is one."""
    if default is not None and key not in record.content:
        return default
    value = number(record, key)
    if value != int(value):
        raise ScenarioError(f"{record.where(key)}: {value!r} is not a whole number")
    return int(value)


def check_arm(properties: Path) -> None:
    """Check that the published arm is the one that the model ``gp4`` describes.

    Raises:
        ScenarioError: its Denavit-Hartenberg table differs.
    """
    path = properties / "gp4_DH.txt"
    if not np.allclose(_table(path, (6, 4)), _GP4, atol=1e-6):
        raise ScenarioError(f"{path}: describes another arm than the model 'gp4'")


def tool_offset(properties: Path, file: str) -> list[float]:
    """Return the origin of a tool frame in the flange frame [m].

    The tables differ in their last row only, d and a of the tool. As that row ends with a half
    turn about x, a frame with (d, a) lies at (a, 0, d_flange - d) in the flange frame, with the
    same axes.

    Args:
        properties: the folder ``robot_properties``.
        file: name of the tool's table.

    Raises:
        ScenarioError: the table is not that of the same arm with another tool.
    """
    path = properties / file
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
        table = np.loadtxt(path, dtype=np.float64)
    except OSError:
        raise ScenarioError(f"{path}: cannot be read") from None
    except ValueError as error:
        raise ScenarioError(f"{path}: {error}") from None
    if table.shape != shape:
        raise ScenarioError(
            f"{path}: has shape {table.shape}, must have {shape[0]} rows of {shape[1]}"
        )
    return np.asarray(table, dtype=np.float64)


def _get(record: Record, key: str) -> Any:
    try:
        return record.content[key]
    except KeyError:
        raise ScenarioError(
            f"{record.where(key)}: is missing", choices=tuple(record.content)[:20]
        ) from None
