"""Writes a scenario's assembly as task files of the form in which APEX-MR publishes its own."""

import os
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.fuzz.task_files import write_files, write_robots
from planning.cell.workcell import Workcell
from planning.lego.bricks.assembly import BrickType, Cell, LegoAssembly, LegoStep, Plate
from planning.lego.bricks.brick_grips import press_cell
from planning.transforms import Array, inverse, translation

_SHOULDER = translation(0.0, 0.0, 0.33)
_FILES = {"flange": "", "tool": "_tool"} | {
    frame: f"_tool_{frame}"
    for frame in ("assemble", "disassemble", "handover_assemble", "alt", "alt_assemble")
}

DATA = Path(
    os.environ.get("ASSEMBLY_TWIN_APEX_DATA")
    or Path(__file__).parents[4] / "../shared/data/apex-mr"
)
"""What the authors published, where it is there."""

needs_data = pytest.mark.skipif(
    not (DATA / "steps").is_dir(), reason="the published APEX-MR data are not there"
)


def published_cell(
    x: int, y: int, z: int, ori: int, prefix: str = ""
) -> dict[str, int]:
    """Return a cell as it is published."""
    keys = (f"{prefix}{k}" for k in ("x", "y", "z", "ori"))
    return dict(zip(keys, (x, y, z, ori), strict=True))


def _cell(prefix: str, cell: Cell) -> dict[str, int]:
    return published_cell(cell.x, cell.y, cell.z, int(cell.turned), prefix)


def types_of(content: Mapping[str, Any]) -> dict[str, BrickType]:
    """Return the brick types of an imported assembly."""
    return {
        name: BrickType(name, tuple(kind["studs"]), kind["mass_kg"])
        for name, kind in content["bricks"].items()
    }


def cell_of(entry: Mapping[str, Any]) -> Cell:
    """Return the cell of an imported brick."""
    x, y, z = entry["at"]
    return Cell(x, y, z, entry.get("turned", False))


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
    kinds = {s.brick.name: s.brick for s in (*assembly.stock, *assembly.steps)}
    numbers = {name: str(k) for k, name in enumerate(sorted(kinds), start=2)}
    _write_cell(folder, cell, assembly)
    library = {
        numbers[name]: {
            **{"height": kind.studs[0], "width": kind.studs[1]},
            **{"inventory": 99, "weight": kind.mass},
        }
        for name, kind in kinds.items()
    }
    names = _stock_names(assembly, numbers)
    stock = {
        names[item.name]: _cell("", item.cell) | ({"fixed": True} if item.fixed else {})
        for item in assembly.stock
    }
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
    files = {
        "lego_library.json": library,
        f"env_setup/env_setup_{task}.json": stock,
        f"assembly_tasks/{task}.json": steps,
    }
    write_files(folder, files)
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
    if step.support is not None:
        entry |= _cell("support_", step.support.cell)
        entry["support_ori"] = step.support.orientation
    elif not terse:
        entry |= published_cell(-1, -1, 0, -1, "support_")
    if step.attack == -1 or not terse:
        entry["attack_dir"] = step.attack
    return entry


def _stock_names(assembly: LegoAssembly, numbers: Mapping[str, str]) -> dict[str, str]:
    """Stations count by type, near the left arm first; other bricks are numbered through."""
    out: dict[str, str] = {}
    stations = Counter[str]()
    for item in sorted(assembly.stock, key=lambda item: item.cell.x):
        if item.station:
            stations[item.brick.name] += 1
            out[item.name] = f"station{stations[item.brick.name]}"
    return {
        item.name: f"b{numbers[item.brick.name]}_{out.get(item.name, k)}"
        for k, item in enumerate(assembly.stock, start=1)
    }


def _write_cell(folder: Path, cell: Workcell, assembly: LegoAssembly) -> None:
    left, right = cell.robots
    world, properties = left.base, folder / "robot_properties"
    tools = {}
    for frame, name in _FILES.items():
        pose = np.eye(4) if frame == "flange" else left.model.frames[frame]
        tools[name] = float(-0.072 - pose[2, 3]), float(pose[0, 3])
    write_robots(folder, tools)
    np.savetxt(properties / "world_base.txt", world)
    for k, robot in enumerate((left, right), start=1):
        base = inverse(world) @ robot.base @ _SHOULDER
        np.savetxt(properties / f"r{k}_base.txt", base)
    plates = {"assemble_plate": _plate(assembly.plate, world)}
    plates["storage_plate"] = _plate(assembly.storage or assembly.plate, world)
    write_files(folder, {"plate_calibration.json": plates})


def _plate(plate: Plate, world: Array) -> dict[str, float]:
    pose = inverse(world) @ plate.pose
    x, y, z = (float(v) for v in pose[:3, 3])
    yaw = float(np.arctan2(pose[1, 0], pose[0, 0]))
    return {
        **{"x": x, "y": y, "z": z, "roll": 0.0, "pitch": 0.0, "yaw": yaw},
        **{"width": plate.studs[0], "height": plate.studs[1]},
        "deg": float(np.degrees(yaw)),
    }
