"""Reads task files as the authors of APEX-MR publish them into a scenario.

Expected in the folder: ``assembly_tasks/<task>.json``, ``env_setup/env_setup_<task>.json``,
``lego_library.json``, ``plate_calibration.json`` and ``robot_properties/``; ``steps/`` only for
the prescribed stock. The result is the plain content of a scenario file.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from planning.errors import ScenarioError
from planning.lego.published_files import (
    TOOL_FILES,
    Record,
    arm_base,
    check_arm,
    integer,
    number,
    read_json,
    tool_offset,
)
from planning.lego.structure import Cell
from planning.transforms import Transform, from_rpy

ROBOT_NAMES = ("left", "right")

HOME_DEG = (0.0, -15.4560442, -40.3565653, 0.0, -65.0994789, 0.0)
"""HOME of both arms: flange at (0.2, 0, 0.4) m in the base frame, pointing down [deg]."""

_TABLE_SIZE = (0.6985, 1.219, 0.02)


def available_tasks(folder: Path) -> tuple[str, ...]:
    """Return the tasks in a folder of published files, sorted."""
    return tuple(sorted(f.stem for f in (folder / "assembly_tasks").glob("*.json")))


def import_apex_mr(
    folder: Path, task: str, *, prescribed_stock: bool = False
) -> dict[str, Any]:
    """Read one published task.

    Args:
        folder: holds the published files.
        task: name of the task, such as ``"cliff"``.
        prescribed_stock: take the stock brick of each step as published, from
            ``steps/<task>_seq.json`` where there is one, instead of leaving it to the planner.

    Returns:
        A scenario as plain dictionaries, lists, strings and numbers, in the shape of a
        scenario file.

    Raises:
        ScenarioError: a file is missing or cannot be read as described; names file and key,
            and the tasks there are.
    """
    folder = Path(folder)
    tasks = available_tasks(folder)
    if task not in tasks:
        raise ScenarioError(f"no published task {task!r} in {folder}", choices=tasks)
    library = read_json(folder / "lego_library.json")
    names = _brick_names(library)
    robots, base_x = _robots(folder)
    plate, plate_z = _plate(folder)
    sequence = folder / "assembly_tasks" / f"{task}.json"
    chosen = folder / "steps" / f"{task}_seq.json"
    if prescribed_stock and chosen.exists():
        sequence = chosen
    stock = _stock(folder / "env_setup" / f"env_setup_{task}.json", names)
    known = tuple(str(item["name"]) for item in stock)
    steps = _steps(sequence, names, known if prescribed_stock else None)
    half = _TABLE_SIZE[2] / 2
    table = {
        "name": "table",
        "size_m": list(_TABLE_SIZE),
        "pose": {
            "xyz_m": [_tidy(sum(base_x) / len(base_x)), 0.0, _tidy(plate_z - half)],
            "rpy_deg": [0.0, 0.0, 0.0],
        },
    }
    return {
        "version": 1,
        "name": task,
        "seed": 0,
        "cell": {"robots": robots, "fixtures": [table]},
        "assembly": {
            "kind": "lego",
            "plate": plate,
            "bricks": _bricks(library, names),
            "stock": stock,
            "steps": steps,
        },
    }


def _brick_names(library: Record) -> dict[str, str]:
    """Return readable names by published number: ``"2x4"``, or ``"1x4-7"`` if not unique."""
    plain = {}
    for key in library.content:
        brick = library.child(key)
        plain[key] = f"{integer(brick, 'height')}x{integer(brick, 'width')}"
    count = Counter(plain.values())
    return {k: n if count[n] == 1 else f"{n}-{k}" for k, n in plain.items()}


def _bricks(library: Record, names: Mapping[str, str]) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for key, name in names.items():
        brick = library.child(key)
        mass = "mass" if "mass" in brick.content else "weight"
        studs = [integer(brick, "height"), integer(brick, "width")]
        out[name] = {"studs": studs, "mass_kg": number(brick, mass)}
    return out


def _robots(folder: Path) -> tuple[list[dict[str, Any]], list[float]]:
    properties = folder / "robot_properties"
    check_arm(properties)
    frames = {
        name: {
            "xyz_m": [_tidy(v) for v in tool_offset(properties, file)],
            "rpy_deg": [0.0, 0.0, 0.0],
        }
        for name, file in TOOL_FILES.items()
    }
    robots: list[dict[str, Any]] = []
    for k, name in enumerate(ROBOT_NAMES, start=1):
        robots.append(
            {
                "name": name,
                "model": "gp4",
                "base": _pose(arm_base(properties, f"r{k}_base.txt")),
                "home_deg": list(HOME_DEG),
                "frames": {
                    n: {k: list(v) for k, v in f.items()} for n, f in frames.items()
                },
            }
        )
    return robots, [r["base"]["xyz_m"][0] for r in robots]


def _plate(folder: Path) -> tuple[dict[str, Any], float]:
    """Return the plate's entry and the height of its surface in the world."""
    file = read_json(folder / "plate_calibration.json")
    poses = []
    for key in ("assemble_plate", "storage_plate"):
        plate = file.child(key)
        xyz = [number(plate, k) for k in ("x", "y", "z")]
        rpy = [number(plate, k) for k in ("roll", "pitch", "yaw")]
        poses.append(from_rpy(xyz, rpy))
    if not np.allclose(poses[0], poses[1], atol=1e-9):
        raise ScenarioError(
            f"{file.path}: assemble_plate and storage_plate are two plates; a scenario has "
            "one, so give both the same pose"
        )
    plate = file.child("assemble_plate")
    studs = [integer(plate, "width"), integer(plate, "height")]
    world = arm_base(folder / "robot_properties", None) @ poses[0]
    return {"pose": _pose(world), "studs": studs}, float(world[2, 3])


def _stock(path: Path, names: Mapping[str, str]) -> list[dict[str, Any]]:
    file = read_json(path)
    out: list[dict[str, Any]] = []
    for name in file.content:
        match = re.fullmatch(r"b(\d+)_(station)?\d+", name)
        if match is None:
            raise ScenarioError(
                f"{path}: {name!r} does not name a brick",
                choices=("b<brick>_<number>", "b<brick>_station<number>"),
            )
        item = file.child(name)
        entry: dict[str, Any] = {
            "name": name,
            "brick": _name(file, name, match[1], names),
            **_cell(item, ""),
        }
        if item.content.get("fixed", False):
            entry["fixed"] = True
        if match[2]:
            entry["station"] = True
        out.append(entry)
    return out


def _steps(
    path: Path, names: Mapping[str, str], stock: tuple[str, ...] | None
) -> list[dict[str, Any]]:
    """Return the steps; ``stock`` lists the bricks there are when they are prescribed."""
    file = read_json(path)
    expected = [str(k) for k in range(1, len(file.content) + 1)]
    if sorted(file.content, key=lambda k: (len(k), k)) != expected:
        raise ScenarioError(f"{path}: steps must be numbered 1 to {len(expected)}")
    out = []
    for key in expected:
        step = file.child(key)
        brick_id = str(integer(step, "brick_id"))
        entry: dict[str, Any] = {
            "brick": _name(file, key, brick_id, names),
            **_cell(step, ""),
        }
        if _choice(step, "manipulate_type", (0, 1), default=0) == 1:
            entry["place"] = "up"
        if "press_side" in step.content:
            entry["press"] = {
                "side": _choice(step, "press_side", (1, 2, 3, 4)),
                "offset": integer(step, "press_offset"),
            }
        if "place" in entry and "press_x" in step.content:
            entry["press_cell"] = _cell(step, "press_")
        if integer(step, "support_x", default=-1) != -1:
            entry["support"] = {
                "at": [integer(step, f"support_{k}") for k in "xyz"],
                "orientation": _choice(step, "support_ori", (0, 1, 2, 3)),
            }
        if _choice(step, "attack_dir", (1, -1), default=1) == -1:
            entry["attack"] = -1
        if stock is not None and "brick_seq" in step.content:
            entry["stock"] = _prescribed(step, brick_id, stock)
        out.append(entry)
    return out


def _prescribed(step: Record, brick_id: str, stock: tuple[str, ...]) -> str:
    # A station's brick is published as "station2.17": the station and the step it is for.
    sequence = str(step.content["brick_seq"]).split(".")[0]
    name = f"b{brick_id}_{sequence}"
    if name not in stock:
        alike = tuple(n for n in stock if n.startswith(f"b{brick_id}_"))
        raise ScenarioError(
            f"{step.where('brick_seq')}: there is no stock brick {name!r}",
            choices=alike,
        )
    return name


def _name(file: Record, key: str, brick_id: str, names: Mapping[str, str]) -> str:
    try:
        return names[brick_id]
    except KeyError:
        raise ScenarioError(
            f"{file.path}: {key}: the library has no brick {brick_id}",
            choices=tuple(names),
        ) from None


def _cell(record: Record, prefix: str) -> dict[str, Any]:
    x, y, z = (integer(record, f"{prefix}{k}") for k in "xyz")
    cell = Cell(x, y, z, _choice(record, f"{prefix}ori", (0, 1)) == 1)
    out: dict[str, Any] = {"at": [cell.x, cell.y, cell.z]}
    if cell.turned:
        out["turned"] = True
    return out


def _choice(
    record: Record, key: str, valid: tuple[int, ...], *, default: int | None = None
) -> int:
    value = integer(record, key, default=default)
    if value not in valid:
        raise ScenarioError(
            f"{record.where(key)}: {value} is not valid",
            choices=tuple(str(v) for v in valid),
        )
    return value


def _pose(pose: Transform) -> dict[str, Any]:
    yaw = math.atan2(pose[1, 0], pose[0, 0])
    pitch = math.atan2(-pose[2, 0], math.hypot(pose[2, 1], pose[2, 2]))
    roll = math.atan2(pose[2, 1], pose[2, 2])
    return {
        "xyz_m": [_tidy(v) for v in pose[:3, 3]],
        "rpy_deg": [_tidy(math.degrees(a)) for a in (roll, pitch, yaw)],
    }


def _tidy(value: float) -> float:
    """Drop what rounding has left behind, and the sign of zero."""
    return round(float(value), 12) + 0.0
