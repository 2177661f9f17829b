"""Writes a scenario's assembly as task files of the form in which APEX-MR publishes its own."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from planning.cell.workcell import Workcell
from planning.lego.bricks.assembly import (
    Cell,
    LegoAssembly,
    LegoStep,
    Plate,
    StockBrick,
)
from planning.lego.bricks.grid import press_cell
from planning.transforms import Array, inverse, translation

_SHOULDER = translation(0.0, 0.0, 0.33)
_ROWS = (
    "0 0 0 -1.57079632679489662",
    "-1.57079632679489662 0 0.26 3.14159265358979323",
    "0 0 0.015 -1.57079632679489662",
    "0 -0.29 0 1.57079632679489662",
    "0 0 0 -1.57079632679489662",
)
_FILES = {
    "flange": "gp4_DH.txt",
    "tool": "gp4_tool_DH.txt",
    "assemble": "gp4_tool_assemble_DH.txt",
    "disassemble": "gp4_tool_disassemble_DH.txt",
    "handover_assemble": "gp4_tool_handover_assemble_DH.txt",
    "alt": "gp4_tool_alt_DH.txt",
    "alt_assemble": "gp4_tool_alt_assemble_DH.txt",
}


def write_published(
    folder: Path,
    task: str,
    cell: Workcell,
    assembly: LegoAssembly,
    *,
    terse: bool = False,
) -> dict[str, str]:
    """Write an assembly and its cell as published files.

    Args:
        folder: where they go.
        task: what it is called.
        cell: with the two arms.
        assembly: with its steps.
        terse: leave out what a reader has to take from elsewhere: the contact cell of places from
            above, offsets of the approach that are usual, the numbers of stock bricks.

    Returns:
        The published name of each stock brick by its own.
    """
    numbers = {
        kind.name: str(k)
        for k, kind in enumerate(
            sorted(
                {s.brick for s in (*assembly.stock, *assembly.steps)},
                key=lambda b: b.name,
            ),
            start=2,
        )
    }
    _write_cell(folder, cell, assembly)
    kinds = {s.brick.name: s.brick for s in (*assembly.stock, *assembly.steps)}
    _write(
        folder / "lego_library.json",
        {
            numbers[name]: {
                "height": kind.studs[0],
                "width": kind.studs[1],
                "inventory": 99,
                "weight": kind.mass,
            }
            for name, kind in kinds.items()
        },
    )
    names = _stock_names(assembly, numbers)
    _write(
        folder / f"env_setup/env_setup_{task}.json",
        {
            names[item.name]: {
                **_cell("", item.cell),
                **({"fixed": True} if item.fixed else {}),
            }
            for item in assembly.stock
        },
    )
    left = [item for item in assembly.stock if not item.fixed]
    steps = {}
    for k, step in enumerate(assembly.steps, start=1):
        entry = _step(step, numbers, terse=terse)
        source = next(
            item
            for item in left
            if item.brick == step.brick and step.stock in (None, item.name)
        )
        if not source.station:
            left.remove(source)
        if not terse:
            number = names[source.name].split("_", 1)[1]
            entry["brick_seq"] = f"{number}.{k}" if source.station else int(number)
        steps[str(k)] = entry
    _write(folder / f"assembly_tasks/{task}.json", steps)
    return names


def _step(step: LegoStep, numbers: Mapping[str, str], *, terse: bool) -> dict[str, Any]:
    entry: dict[str, Any] = {
        "brick_id": int(numbers[step.brick.name]),
        **_cell("", step.cell),
        "manipulate_type": int(step.up),
    }
    if step.press is not None:
        entry |= {"press_side": step.press.side, "press_offset": step.press.offset}
        if step.up or not terse:
            contact = press_cell(step, step.press, up=step.up)
            entry |= _cell("press_", contact)
    held = step.support
    if held is None:
        none = {"support_x": -1, "support_y": -1, "support_z": 0, "support_ori": -1}
        entry |= {} if terse else none
    else:
        at = held.cell
        entry |= {"support_x": at.x, "support_y": at.y, "support_z": at.z}
        entry["support_ori"] = held.orientation
    if step.attack == -1 or not terse:
        entry["attack_dir"] = step.attack
    return entry


def _stock_names(assembly: LegoAssembly, numbers: Mapping[str, str]) -> dict[str, str]:
    """Stations count by type, near the left arm first; other bricks are numbered through."""
    out: dict[str, str] = {}
    stations: dict[str, int] = {}

    def near(item: StockBrick) -> int:
        return item.cell.x

    for item in sorted(assembly.stock, key=near):
        if item.station:
            stations[item.brick.name] = stations.get(item.brick.name, 0) + 1
            out[item.name] = f"station{stations[item.brick.name]}"
    for k, item in enumerate(assembly.stock, start=1):
        out.setdefault(item.name, str(k))
    return {
        item.name: f"b{numbers[item.brick.name]}_{out[item.name]}"
        for item in assembly.stock
    }


def _cell(prefix: str, cell: Cell) -> dict[str, int]:
    return {
        f"{prefix}x": cell.x,
        f"{prefix}y": cell.y,
        f"{prefix}z": cell.z,
        f"{prefix}ori": int(cell.turned),
    }


def _write_cell(folder: Path, cell: Workcell, assembly: LegoAssembly) -> None:
    left, right = cell.robots
    world = left.base @ translation(0.0, 0.0, 0.0)
    properties = folder / "robot_properties"
    properties.mkdir(parents=True, exist_ok=True)
    np.savetxt(properties / "world_base.txt", world)
    np.savetxt(properties / "gp4_base.txt", _SHOULDER)
    for k, robot in enumerate((left, right), start=1):
        base = inverse(world) @ robot.base @ _SHOULDER
        np.savetxt(properties / f"r{k}_base.txt", base)
    for frame, name in _FILES.items():
        pose = np.eye(4) if frame == "flange" else left.model.frames[frame]
        d, a = float(-0.072 - pose[2, 3]), float(pose[0, 3])
        row = f"0 {d!r} {a!r} 3.14159265358979323"
        (properties / name).write_text("\n".join([*_ROWS, row]))
    plates = {"assemble_plate": _plate(assembly.plate, world)}
    plates["storage_plate"] = _plate(assembly.storage or assembly.plate, world)
    _write(folder / "plate_calibration.json", plates)


def _plate(plate: Plate, world: Array) -> dict[str, float]:
    pose = inverse(world) @ plate.pose
    x, y, z = (float(v) for v in pose[:3, 3])
    yaw = float(np.arctan2(pose[1, 0], pose[0, 0]))
    return {
        **{"x": x, "y": y, "z": z, "roll": 0.0, "pitch": 0.0, "yaw": yaw},
        "width": plate.studs[0],
        "height": plate.studs[1],
        "deg": float(np.degrees(yaw)),
    }


def _write(path: Path, content: Any) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content, indent=1))
