"""The cell of a published APEX-MR task: two arms, table and plates."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from planning.importers.apex_mr.task_files import (
    TOOLS,
    Notes,
    Record,
    arm_base,
    check_arm,
    integer,
    number,
    read_json,
    tool_file,
    tool_offset,
)
from planning.transforms import Transform, from_rpy

ROBOT_NAMES = ("left", "right")

HOME_DEG = (0.0, -15.4560442, -40.3565653, 0.0, -65.0994789, 0.0)
"""HOME of both arms: flange at (0.2, 0, 0.4) m in the base frame, pointing down [deg]."""

_TABLE_SIZE = (0.6985, 1.219, 0.02)
_STUDS = 48
_PLATE_KEYS = frozenset(
    ("x", "y", "z", "roll", "pitch", "yaw", "deg", "width", "height")
)


def published_robots(folder: Path) -> list[dict[str, Any]]:
    """Return the entries of the two arms.

    Raises:
        ScenarioError: a file is missing, or describes another arm.
    """
    properties = folder / "robot_properties"
    check_arm(properties)
    robots: list[dict[str, Any]] = []
    for k, name in enumerate(ROBOT_NAMES, start=1):
        frames = {}
        for frame, tool in TOOLS.items():
            offset = tool_offset(tool_file(properties, f"r{k}", tool))
            frames[frame] = {
                "xyz_m": [tidy(v) for v in offset],
                "rpy_deg": [0.0, 0.0, 0.0],
            }
        robots.append(
            {
                "name": name,
                "model": "gp4",
                "base": _pose(arm_base(properties, f"r{k}_base.txt")),
                "home_deg": list(HOME_DEG),
                "frames": frames,
            }
        )
    return robots


def published_plates(folder: Path, notes: Notes) -> dict[str, Any]:
    """Return ``plate``, and ``storage_plate`` where it is not the same."""
    file = read_json(folder / "plate_calibration.json")
    notes.unused(file, frozenset(("assemble_plate", "storage_plate")))
    world = arm_base(folder / "robot_properties", None)
    plate = _plate(file.child("assemble_plate"), world, notes)
    if "storage_plate" not in file.content:
        return {"plate": plate}
    storage = _plate(file.child("storage_plate"), world, notes)
    same = storage["studs"] == plate["studs"] and all(
        np.allclose(storage["pose"][k], plate["pose"][k], atol=1e-7)
        for k in ("xyz_m", "rpy_deg")
    )
    return {"plate": plate} if same else {"plate": plate, "storage_plate": storage}


def table_below(robots: list[dict[str, Any]], plates: dict[str, Any]) -> dict[str, Any]:
    """Return the table between the robots, its top level with the lower plate's surface."""
    top = min(plate["pose"]["xyz_m"][2] for plate in plates.values())
    middle = sum(r["base"]["xyz_m"][0] for r in robots) / len(robots)
    xyz = [tidy(middle), 0.0, tidy(top - _TABLE_SIZE[2] / 2)]
    return {
        "name": "table",
        "size_m": list(_TABLE_SIZE),
        "pose": {"xyz_m": xyz, "rpy_deg": [0.0, 0.0, 0.0]},
    }


def published_twists(folder: Path) -> dict[str, Any]:
    """Return the twist angles where the folder has a ``user_config.json`` with others."""
    path = folder / "user_config.json"
    if not path.exists():
        return {}
    config = read_json(path)
    twist = number(config, "Twist_Deg", default=16.0)
    handover = number(config, "Handover_Twist_Deg", default=18.0)
    if (twist, handover) == (16.0, 18.0):
        return {}
    skills = ("pick", "place-down", "place-up")
    return {"twist_deg": {**dict.fromkeys(skills, twist), "handover": handover}}


def _plate(plate: Record, world: Transform, notes: Notes) -> dict[str, Any]:
    notes.unused(plate, _PLATE_KEYS)
    xyz = [number(plate, k) for k in ("x", "y", "z")]
    yaw = math.radians(number(plate, "deg", default=0.0))
    rpy = [number(plate, k, default=0.0) for k in ("roll", "pitch")]
    rpy.append(number(plate, "yaw", default=yaw))
    studs = [integer(plate, k, default=_STUDS) for k in ("width", "height")]
    return {"pose": _pose(world @ from_rpy(xyz, rpy)), "studs": studs}


def _pose(pose: Transform) -> dict[str, Any]:
    yaw = math.atan2(pose[1, 0], pose[0, 0])
    pitch = math.atan2(-pose[2, 0], math.hypot(pose[2, 1], pose[2, 2]))
    roll = math.atan2(pose[2, 1], pose[2, 2])
    return {
        "xyz_m": [tidy(v) for v in pose[:3, 3]],
        "rpy_deg": [tidy(math.degrees(a)) for a in (roll, pitch, yaw)],
    }


def tidy(value: float) -> float:
    """Drop what rounding has left behind, and the sign of zero."""
    return round(float(value), 12) + 0.0
