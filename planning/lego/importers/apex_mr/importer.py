"""Import of published APEX-MR task files as a scenario.

Required in the folder: ``assembly_tasks/<task>.json``, ``env_setup/env_setup_<task>.json``, ``lego_library.json``,
``plate_calibration.json`` and ``robot_properties/``. Optional: ``steps/`` for the prescribed stock, and
``user_config.json`` for other twist angles than the default. The result is the content of a scenario file, as plain
data. A step of a task file may specify its grip in two ways.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

from planning.errors import ScenarioError
from planning.lego.bricks.assembly import BrickType, PlacedBrick, Press
from planning.lego.bricks.brick_grips import SIDES, legal_offsets, press_cell
from planning.lego.importers.apex_mr.published_arm import (
    arm_base,
    check_arm,
    tool_offset,
)
from planning.lego.importers.apex_mr.task_files import (
    NONE,
    TOOLS,
    Notes,
    Record,
    read_json,
)
from planning.transforms import Transform, from_rpy

_ROBOT_NAMES = ("left", "right")

HOME_DEG = (0.0, -15.4560442, -40.3565653, 0.0, -65.0994789, 0.0)
"""HOME of both arms: flange at (0.2, 0, 0.4) m in the base frame, pointing down [deg]."""

_TABLE_SIZE = (0.6985, 1.219, 0.02)
_STUDS = 48
_PLATE_KEYS = frozenset(
    ("x", "y", "z", "roll", "pitch", "yaw", "deg", "width", "height")
)


PressFrom = Literal["side", "cell"]
"""What a grip is read from: ``press_side`` and ``press_offset``, or ``press_x`` and so on."""

_CELL = ("x", "y", "z", "ori")
_BRICK_KEYS = frozenset(("height", "width", "weight", "mass", "inventory"))
_STOCK_KEYS = frozenset((*_CELL, "fixed"))
_STEP_KEYS = frozenset(
    (
        *_CELL,
        "brick_id",
        "press_side",
        "press_offset",
        "manipulate_type",
        "attack_dir",
        *(f"press_{k}" for k in _CELL),
        *(f"support_{k}" for k in _CELL),
        "brick_seq",
        "robot_id",
        "sup_robot_id",
    )
)

Types = Mapping[str, BrickType]
"""Brick types by their published numbers."""


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
        note: called with a line for everything that is not imported: keys that say nothing
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
    types = _bricks(library)
    robots = _robots(folder)
    plates = _plates(folder, notes)
    stock = _stock(_stock_file(folder, task), types, notes)
    for key in types:
        notes.unused(library.child(key), _BRICK_KEYS)
    sequence = folder / "assembly_tasks" / f"{task}.json"
    chosen = folder / "steps" / f"{task}_seq.json"
    if prescribed_stock and chosen.exists():
        sequence = chosen
    prescribed = stock if prescribed_stock else None
    steps = _steps(sequence, types, prescribed, press_from, notes)
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
            "bricks": {
                kind.name: {"studs": list(kind.studs), "mass_kg": kind.mass}
                for kind in types.values()
            },
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
        for k, name in enumerate(_ROBOT_NAMES, start=1)
    ]


def _plates(folder: Path, notes: Notes) -> dict[str, Any]:
    """Return ``plate``, and ``storage_plate`` where it is a separate one."""
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
    """Return the twist angles of the folder's ``user_config.json``, where it overrides the defaults."""
    path = folder / "user_config.json"
    if not path.exists():
        return {}
    config = read_json(path)
    twist = config.number("Twist_Deg", default=16.0)
    handover = config.number("Handover_Twist_Deg", default=18.0)
    if (twist, handover) == (16.0, 18.0):
        return {}
    skills = ("pick", "place-down", "place-up")
    return {"twist_deg": {**dict.fromkeys(skills, twist), "handover": handover}}


def _plate(plate: Record, world: Transform, notes: Notes) -> dict[str, Any]:
    notes.unused(plate, _PLATE_KEYS)
    xyz = [plate.number(k) for k in ("x", "y", "z")]
    yaw = math.radians(plate.number("deg", default=0.0))
    rpy = [plate.number(k, default=0.0) for k in ("roll", "pitch")]
    rpy.append(plate.number("yaw", default=yaw))
    studs = [plate.integer(k, default=_STUDS) for k in ("width", "height")]
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
    """Remove rounding errors, and the sign of zero."""
    return round(float(value), 12) + 0.0


def _bricks(library: Record) -> dict[str, BrickType]:
    """Return the brick types, with readable names: ``"2x4"``, or ``"1x4-7"`` if not unique."""
    records = {key: library.child(key) for key in library.content}
    studs = {k: (r.integer("height"), r.integer("width")) for k, r in records.items()}
    count = Counter(studs.values())
    out = {}
    for key, brick in records.items():
        own = studs[key]
        name = f"{own[0]}x{own[1]}" + (f"-{key}" if count[own] > 1 else "")
        mass = brick.number("mass" if "mass" in brick.content else "weight")
        out[key] = BrickType(name, own, mass)
    return out


def _stock(path: Path, types: Types, notes: Notes) -> list[dict[str, Any]]:
    """Return the entries of the stock, stations and scaffolding included."""
    file = read_json(path)
    out: list[dict[str, Any]] = []
    for name, value in file.content.items():
        match = re.fullmatch(r"b(\d+)_([A-Za-z0-9_-]+)", name)
        if match is None and not isinstance(value, dict):
            notes.unused_key(file, name)
            continue
        if match is None:
            raise ScenarioError(
                f"{path}: {name!r} does not name a brick",
                choices=("b<brick>_<number>", "b<brick>_station<number>"),
            )
        item = file.child(name)
        notes.unused(item, _STOCK_KEYS)
        kind = _type(file, name, match[1], types)
        entry = {"name": name, "brick": kind.name, **item.cell("").entry}
        if item.content.get("fixed", False):
            entry["fixed"] = True
        if re.fullmatch(r"station\d*", match[2]):
            if "fixed" in entry:
                raise ScenarioError(
                    f"{item.where('fixed')}: a feeding station cannot be fixed"
                )
            entry["station"] = True
        out.append(entry)
    return out


def _steps(
    path: Path,
    types: Types,
    stock: Sequence[Mapping[str, Any]] | None,
    wanted: PressFrom,
    notes: Notes,
) -> list[dict[str, Any]]:
    """Return the entries of the steps, in order.

    Published numbers of stock bricks can be older than the stock: one that is scaffolding now,
    or taken by an earlier step, is not imported.

    Args:
        path: of the task, or of the sequence that was chosen for it.
        types: of bricks.
        stock: entries of the stock when steps prescribe it, None when they do not.
        wanted: what a grip is read from where both are given.
        notes: takes what is not used, and contradictions.
    """
    file = read_json(path)
    keys = []
    for key, value in file.content.items():
        if isinstance(value, dict) or key.isdecimal():
            keys.append(key)
        else:
            notes.unused_key(file, key)
    expected = [str(k) for k in range(1, len(keys) + 1)]
    if not keys or sorted(keys, key=lambda k: (len(k), k)) != expected:
        last = max(1, len(expected))
        raise ScenarioError(f"{path}: steps must be numbered 1 to {last}")
    out = []
    used: set[str] = set()
    for key in expected:
        step = file.child(key)
        notes.unused(step, _STEP_KEYS)
        number = str(step.integer("brick_id"))
        kind = _type(file, key, number, types)
        entry = {"brick": kind.name, **step.cell("").entry}
        entry |= _method(step, _press(step, kind, wanted, notes))
        if stock is not None and step.content.get("brick_seq") not in (None, "", NONE):
            source = _prescribed(step, number, stock)
            if source.get("fixed") or source["name"] in used:
                why = "scaffolding" if source.get("fixed") else "taken already"
                notes.add(f"{step.where('brick_seq')}: {source['name']} is {why}")
            else:
                entry["stock"] = source["name"]
                if not source.get("station"):
                    used.add(source["name"])
        out.append(entry)
    return out


def _method(step: Record, press: Mapping[str, Any]) -> dict[str, Any]:
    """Return the method of a step, as far as the file states it, with the grip that was read."""
    entry: dict[str, Any] = {"place": "up"} if _is_up(step) else {}
    entry |= press
    if step.integer("support_x", default=NONE) != NONE:
        entry["support"] = {
            "at": [step.integer(f"support_{k}") for k in "xyz"],
            "orientation": step.choice("support_ori", (0, 1, 2, 3)),
        }
    if step.choice("attack_dir", (1, -1), default=1) == -1:
        entry["attack"] = -1
    return entry


def _is_up(step: Record) -> bool:
    return step.choice("manipulate_type", (0, 1), default=0) == 1


def _press(
    step: Record, kind: BrickType, wanted: PressFrom, notes: Notes
) -> dict[str, Any]:
    """Return the entries of a step's grip, none where the step gives none.

    A place from below keeps the contact cell as well, unless side and offset are wanted and
    contradict it.
    """
    side = step.choice("press_side", (1, 2, 3, 4, NONE), default=NONE)
    offset = step.integer("press_offset", default=NONE)
    given = None if NONE in (side, offset) else Press(side, offset)
    up = _is_up(step)
    entry = {} if given is None else _entry(given)
    if step.integer("press_x", default=NONE) == NONE:
        return entry
    contact = {"press_cell": step.cell("press_").entry} if up else {}
    found = _presses_at(step, kind, up=up)
    if given in found:
        return entry | contact
    if given is None:
        return entry | contact if not found else _entry(found[0]) | contact
    where = f"{step.path}: {step.key}"
    about = f"press side {side} and offset {offset}"
    if not found:
        notes.add(
            f"{where}: {about} are taken: press_x, press_y, press_z and press_ori are no "
            f"place on an edge of the {kind.name}"
        )
        return entry
    this = (
        f"press_x and press_ori say side {found[0].side} and offset {found[0].offset}"
    )
    if wanted == "cell":
        notes.add(f"{where}: {this}, which is taken; it also gives {about}")
        return _entry(found[0]) | contact
    notes.add(f"{where}: {about} are taken; {this} (--press-from cell takes that)")
    return entry


def _presses_at(step: Record, kind: BrickType, *, up: bool) -> list[Press]:
    """Return the grips whose contact is the published cell, those of the given side first."""
    item, contact = PlacedBrick("", kind, step.cell("")), step.cell("press_")
    sides = sorted(SIDES, key=lambda k: k != step.content.get("press_side"))
    grips = (
        Press(side, offset) for side in sides for offset in legal_offsets(kind, side)
    )
    return [press for press in grips if press_cell(item, press, up=up) == contact]


def _entry(press: Press) -> dict[str, Any]:
    return {"press": {"side": press.side, "offset": press.offset}}


def _prescribed(
    step: Record, number: str, stock: Sequence[Mapping[str, Any]]
) -> Mapping[str, Any]:
    # A station's brick is published as "station2.17": the station and the step it is for.
    sequence = str(step.content["brick_seq"]).split(".")[0]
    by_name = {str(item["name"]): item for item in stock}
    name = f"b{number}_{sequence}"
    if name not in by_name:
        raise ScenarioError(
            f"{step.where('brick_seq')}: there is no stock brick {name!r}",
            choices=tuple(k for k in by_name if k.startswith(f"b{number}_")),
        )
    return by_name[name]


def _type(file: Record, key: str, number: str, types: Types) -> BrickType:
    if number not in types:
        raise ScenarioError(
            f"{file.path}: {key}: the library has no brick {number}",
            choices=tuple(types),
        )
    return types[number]
