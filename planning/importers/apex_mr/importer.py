"""Import of task files as the authors of APEX-MR publish them, as a scenario.

Expected in the folder: ``assembly_tasks/<task>.json``, ``env_setup/env_setup_<task>.json``,
``lego_library.json``, ``plate_calibration.json`` and ``robot_properties/``; ``steps/`` only for
the prescribed stock, ``user_config.json`` only for other twist angles than usual. The result is
the plain content of a scenario file.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from planning.errors import ScenarioError
from planning.importers.apex_mr.brick_steps import (
    PressFrom,
    PressReader,
    brick_names,
    published_bricks,
    published_steps,
    published_stock,
)
from planning.importers.apex_mr.task_files import (
    TOOLS,
    Notes,
    Record,
    arm_base,
    check_arm,
    integer,
    number,
    read_json,
    tool_offset,
)
from planning.lego.bricks.assembly import BrickType
from planning.transforms import Transform, from_rpy

ROBOT_NAMES = ("left", "right")

HOME_DEG = (0.0, -15.4560442, -40.3565653, 0.0, -65.0994789, 0.0)
"""HOME of both arms: flange at (0.2, 0, 0.4) m in the base frame, pointing down [deg]."""

_TABLE_SIZE = (0.6985, 1.219, 0.02)
_STUDS = 48
_PLATE_KEYS = frozenset(
    ("x", "y", "z", "roll", "pitch", "yaw", "deg", "width", "height")
)


def available_tasks(folder: Path) -> tuple[str, ...]:
    """Return the tasks in a folder of published files, sorted."""
    tasks = _task_folder(folder) / "assembly_tasks"
    return tuple(sorted(f.stem for f in tasks.glob("*.json")))


def import_apex_mr(
    folder: Path,
    task: str,
    *,
    prescribed_stock: bool = False,
    press_from: PressFrom = "side",
    note: Callable[[str], None] = lambda text: None,
) -> dict[str, Any]:
    """Read one published task.

    Args:
        folder: holds the published files, or is the repository that has them in
            ``config/lego_tasks``.
        task: name of the task, such as ``"cliff"``.
        prescribed_stock: take the stock brick of each step as published, from
            ``steps/<task>_seq.json`` where there is one, instead of leaving it to the planner.
        press_from: which of the two ways in which a grip is given is taken where they
            contradict each other: ``press_side`` and ``press_offset``, or the cell ``press_x``.
        note: called with a line for everything that is not taken over: keys that say nothing
            to us, prescribed bricks that the stock no longer has to give, grips that contradict
            themselves.

    Returns:
        A scenario as plain dictionaries, lists, strings and numbers, in the shape of a
        scenario file.

    Raises:
        ScenarioError: a file is missing or cannot be read as described; names file and key,
            and the tasks there are.
    """
    folder = _task_folder(Path(folder))
    tasks = available_tasks(folder)
    if task not in tasks:
        raise ScenarioError(f"no published task {task!r} in {folder}", choices=tasks)
    notes = Notes()
    library = read_json(folder / "lego_library.json")
    names = brick_names(library)
    robots = _robots(folder)
    plates = _plates(folder, notes)
    stock = published_stock(_stock_file(folder, task), names, notes)
    sequence = folder / "assembly_tasks" / f"{task}.json"
    chosen = folder / "steps" / f"{task}_seq.json"
    if prescribed_stock and chosen.exists():
        sequence = chosen
    bricks = published_bricks(library, names, notes)
    types = {
        key: BrickType(name, tuple(bricks[name]["studs"]), bricks[name]["mass_kg"])
        for key, name in names.items()
    }
    reader = PressReader(types, press_from, notes)
    prescribed = stock if prescribed_stock else None
    steps = published_steps(sequence, names, prescribed, notes, reader)
    for line in notes.lines():
        note(line)
    return {
        "version": 1,
        "name": re.sub(r"[^A-Za-z0-9_.-]", "_", task),
        "seed": 0,
        "cell": {"robots": robots, "fixtures": [_table(robots, plates)]},
        "assembly": {
            "kind": "lego",
            **plates,
            "bricks": bricks,
            "stock": stock,
            "steps": steps,
            **_twists(folder),
        },
    }


def _task_folder(folder: Path) -> Path:
    inner = folder / "config" / "lego_tasks"
    if not (folder / "assembly_tasks").is_dir() and inner.is_dir():
        return inner
    return folder


def _stock_file(folder: Path, task: str) -> Path:
    path = folder / "env_setup" / f"env_setup_{task}.json"
    if not path.exists():
        others = sorted(path.parent.glob("env_setup_*.json"))
        raise ScenarioError(
            f"{path}: cannot be read: task {task!r} comes without a stock",
            choices=tuple(p.stem.removeprefix("env_setup_") for p in others),
        )
    return path


def _robots(folder: Path) -> list[dict[str, Any]]:
    """Return the entries of the two arms, which must be those that ``gp4`` describes."""
    properties = folder / "robot_properties"
    check_arm(properties)
    return [
        {
            "name": name,
            "model": "gp4",
            "base": _pose(arm_base(properties, f"r{k}_base.txt")),
            "home_deg": list(HOME_DEG),
            "frames": {
                frame: _upright(tool_offset(properties, f"r{k}", file))
                for frame, file in TOOLS.items()
            },
        }
        for k, name in enumerate(ROBOT_NAMES, start=1)
    ]


def _plates(folder: Path, notes: Notes) -> dict[str, Any]:
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


def _table(robots: list[dict[str, Any]], plates: dict[str, Any]) -> dict[str, Any]:
    """Return the table between the robots, its top level with the lower plate's surface."""
    top = min(plate["pose"]["xyz_m"][2] for plate in plates.values())
    middle = sum(r["base"]["xyz_m"][0] for r in robots) / len(robots)
    pose = _upright([middle, 0.0, top - _TABLE_SIZE[2] / 2])
    return {"name": "table", "size_m": list(_TABLE_SIZE), "pose": pose}


def _twists(folder: Path) -> dict[str, Any]:
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
        "xyz_m": [_tidy(v) for v in pose[:3, 3]],
        "rpy_deg": [_tidy(math.degrees(a)) for a in (roll, pitch, yaw)],
    }


def _upright(xyz: Sequence[float]) -> dict[str, Any]:
    return {"xyz_m": [_tidy(v) for v in xyz], "rpy_deg": [0.0, 0.0, 0.0]}


def _tidy(value: float) -> float:
    """Drop what rounding has left behind, and the sign of zero."""
    return round(float(value), 12) + 0.0
