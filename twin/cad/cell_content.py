"""Content of the scenario of an assembly from CAD: cell, parts, their places, and steps."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from planning.cad.exact_forms import BallForm, BoxForm, RodForm
from planning.cad.layout import Layout
from planning.cad.part_types import PartType
from planning.files import replace_atomically
from planning.transforms import Transform, from_rpy, quat_wxyz

_PALETTE = (
    *((88, 118, 152), (201, 162, 75), (184, 67, 58), (110, 150, 100)),
    *((150, 120, 160), (170, 174, 180), (70, 74, 82), (190, 140, 90)),
)
"""Colours of types that the file gives none."""

_DIGITS = 7
"""Decimals of positions [m]: files have seven digits."""

_ANGLE_DIGITS = 5
"""Decimals of angles [deg], where these give the rotation exactly."""


@dataclass(frozen=True, eq=False)
class PartEntry:
    """Parts of the scenario that are alike.

    Attributes:
        name: of the entry.
        type: what they are.
        goals: poses of their frame in the world.
        insert: direction in the world in which they are led into their places.
        approach: length of the straight insertion [m].
        density: [kg/m^3].
    """

    name: str
    type: PartType
    goals: tuple[Transform, ...]
    insert: tuple[float, float, float]
    approach: float
    density: float


def part_content(
    entry: PartEntry,
    shape: Mapping[str, Any],
    starts: Sequence[Transform],
    number: int,
    grips: Mapping[str, float],
) -> dict[str, Any]:
    """Return the entry of a part, or of parts that are alike, in ``assembly.parts``.

    The number of the type is for its colour; rules for grips are those that are others than the assembly's.
    """
    out: dict[str, Any] = {"name": entry.name, **shape}
    begin = [pose_content(pose) for pose in starts]
    end = [pose_content(pose) for pose in entry.goals]
    if len(end) == 1:
        out |= {"start": begin[0], "goal": end[0]}
    else:
        out |= {"count": len(end), "starts": begin, "goals": end}
    out["density_kg_m3"] = entry.density
    out["colour"] = colour_of(entry.type, number)
    if entry.insert != (0.0, 0.0, -1.0):
        out["insert"] = list(entry.insert)
    out["approach_m"] = entry.approach
    if grips:
        out["grips"] = dict(grips)
    return out


def stand_content(name: str, layout: Layout, top: float) -> dict[str, Any]:
    """Return the fixture of the stands on which the parts of an entry lie, at the height of the table [m]."""
    lying = layout.lying[name]
    size = [*lying.size, lying.stand]
    places = [
        [*pose[:2, 3].round(_DIGITS).tolist(), round(0.5 * lying.stand, _DIGITS)]
        for pose in layout.starts[name]
    ]
    boxes = [{"box": size, "pose": {"xyz_m": at}} for at in places]
    shape = {"shape": {"compound": boxes}}
    return {"name": f"{name}_stand", **shape, "pose": {"xyz_m": [0.0, 0.0, top]}}


def colour_of(kind: PartType, number: int) -> list[int]:
    """Return the colour of a type: that of the file, or one by its number."""
    return list(kind.placed[0].body.colour or _PALETTE[number % len(_PALETTE)])


def shape_content(kind: PartType, mesh: str) -> dict[str, Any]:
    """Return the shape of a type as keys of a part or a fixture, given the path of its mesh file if it is no form."""
    form = kind.form
    if isinstance(form, BoxForm):
        return {"size_m": list(form.size)}
    if isinstance(form, BallForm):
        return {"shape": {"capsule": {"radius_m": form.radius, "length_m": 0}}}
    if isinstance(form, RodForm):
        if len(form.rows) == 1:
            return {"shape": _cylinder(*form.rows[0])}
        out, low = [], -0.5 * form.length
        for radius, length in form.rows:
            at = round(low + 0.5 * length, _DIGITS)
            out.append({**_cylinder(radius, length), "pose": {"xyz_m": [0, 0, at]}})
            low += length
        return {"shape": {"compound": out}}
    return {"shape": {"mesh": mesh, "scale": 1}}


def _cylinder(radius: float, length: float) -> dict[str, Any]:
    return {"cylinder": {"radius_m": radius, "length_m": round(length, _DIGITS)}}


def pose_content(pose: Transform) -> dict[str, Any]:
    """Return a pose for a scenario: angles where few digits are exact, else a quaternion."""
    at = [round(value, _DIGITS) + 0.0 for value in pose[:3, 3].tolist()]
    if np.allclose(pose[:3, :3], np.eye(3), atol=1e-9):
        return {"xyz_m": at}
    turn = pose[:3, :3]
    pitch = math.asin(max(-1.0, min(1.0, -float(turn[2, 0]))))
    if abs(turn[2, 0]) < 1.0 - 1e-9:
        roll = math.atan2(turn[2, 1], turn[2, 2])
        yaw = math.atan2(turn[1, 0], turn[0, 0])
    else:
        roll, yaw = 0.0, math.atan2(-turn[0, 1], turn[1, 1])
    angles = [round(math.degrees(a), _ANGLE_DIGITS) + 0.0 for a in (roll, pitch, yaw)]
    again = from_rpy((0.0, 0.0, 0.0), [math.radians(a) for a in angles])
    if np.allclose(again[:3, :3], turn, atol=1e-7):
        return {"xyz_m": at, "rpy_deg": angles}
    digits = [round(value, 9) for value in np.asarray(quat_wxyz(pose)).tolist()]
    return {"xyz_m": at, "quat_wxyz": digits}


def write_mesh(kind: PartType, path: Path) -> None:
    """Write the mesh of a type as binary STL, in metres, in the frame of the type."""
    import trimesh

    mesh = trimesh.Trimesh(kind.vertices, kind.placed[0].body.faces, process=False)
    with replace_atomically(path) as temporary:
        mesh.export(str(temporary), file_type="stl")
