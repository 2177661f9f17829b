"""Brick types, stock and steps of a published APEX-MR task, with the grips that it gives twice."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

from planning.errors import ScenarioError
from planning.importers.apex_mr.task_files import (
    NONE,
    Notes,
    Record,
    cell_entry,
    choice,
    integer,
    number,
    read_json,
)
from planning.lego.bricks.assembly import BrickType, Cell, PlacedBrick, Press
from planning.lego.bricks.grid import SIDES, offsets, press_cell

PressFrom = Literal["side", "cell"]
"""What a grip is read from: ``press_side`` and ``press_offset``, or ``press_x`` and so on."""

READINGS: Mapping[str, PressFrom] = MappingProxyType({"side": "side", "cell": "cell"})
"""The two by name."""


@dataclass(frozen=True)
class PressReader:
    """Reads the grips of steps.

    Attributes:
        bricks: brick types by their published numbers.
        wanted: what a grip is read from where both are given.
        notes: takes contradictions.
    """

    bricks: Mapping[str, BrickType]
    wanted: PressFrom
    notes: Notes

    def press(self, step: Record, brick_id: str) -> dict[str, Any]:
        """Return the entries of a step's grip, none where the step gives none.

        A place from below keeps the contact cell as well, unless side and offset are wanted and
        contradict it.
        """
        side = choice(step, "press_side", (1, 2, 3, 4, NONE), default=NONE)
        offset = integer(step, "press_offset", default=NONE)
        given = None if NONE in (side, offset) else Press(side, offset)
        up = choice(step, "manipulate_type", (0, 1), default=0) == 1
        entry = {} if given is None else _entry(given)
        brick = self.bricks.get(brick_id)
        if integer(step, "press_x", default=NONE) == NONE or brick is None:
            return entry
        contact = {"press_cell": cell_entry(step, "press_")} if up else {}
        presses = _presses_at(step, brick, up=up)
        if given in presses:
            return entry | contact
        if given is None:
            return entry | contact if not presses else _entry(presses[0]) | contact
        where = f"{step.path}: {step.key}"
        about = f"press side {side} and offset {offset}"
        if not presses:
            self.notes.add(
                f"{where}: {about} are taken: press_x, press_y, press_z and press_ori are no "
                f"place on an edge of the {brick.name}"
            )
            return entry
        other = presses[0]
        this = f"press_x and press_ori say side {other.side} and offset {other.offset}"
        if self.wanted == "cell":
            self.notes.add(f"{where}: {this}, which is taken; it also gives {about}")
            return _entry(other) | contact
        self.notes.add(
            f"{where}: {about} are taken; {this} (--press-from cell takes that)"
        )
        return entry


def _presses_at(step: Record, brick: BrickType, *, up: bool) -> list[Press]:
    """Return the grips whose contact is the published cell, that of the given side first."""
    cell, contact = (cell_entry(step, prefix) for prefix in ("", "press_"))
    item, wanted = PlacedBrick("", brick, _cell(cell)), _cell(contact)
    found = []
    for side in sorted(SIDES, key=lambda k: k != step.content.get("press_side")):
        for offset in offsets(brick, side):
            press = Press(side, offset)
            try:
                same = press_cell(item, press, up=up) == wanted
            except ScenarioError:
                continue
            if same:
                found.append(press)
    return found


def _entry(press: Press) -> dict[str, Any]:
    return {"press": {"side": press.side, "offset": press.offset}}


def _cell(entry: Mapping[str, Any]) -> Cell:
    x, y, z = entry["at"]
    return Cell(x, y, z, "turned" in entry)


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


def brick_names(library: Record) -> dict[str, str]:
    """Return readable names by published number: ``"2x4"``, or ``"1x4-7"`` if not unique."""
    plain = {}
    for key in library.content:
        brick = library.child(key)
        plain[key] = f"{integer(brick, 'height')}x{integer(brick, 'width')}"
    count = Counter(plain.values())
    return {k: n if count[n] == 1 else f"{n}-{k}" for k, n in plain.items()}


def published_bricks(
    library: Record, names: Mapping[str, str], notes: Notes
) -> dict[str, Any]:
    """Return the entries of the brick types."""
    out: dict[str, Any] = {}
    for key, name in names.items():
        brick = library.child(key)
        notes.unused(brick, _BRICK_KEYS)
        mass = "mass" if "mass" in brick.content else "weight"
        studs = [integer(brick, "height"), integer(brick, "width")]
        out[name] = {"studs": studs, "mass_kg": number(brick, mass)}
    return out


def published_stock(
    path: Path, names: Mapping[str, str], notes: Notes
) -> list[dict[str, Any]]:
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
        entry: dict[str, Any] = {
            "name": name,
            "brick": _name(file, name, match[1], names),
            **cell_entry(item, ""),
        }
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


def published_steps(
    path: Path,
    names: Mapping[str, str],
    stock: Sequence[Mapping[str, Any]] | None,
    notes: Notes,
    presses_of: PressReader,
) -> list[dict[str, Any]]:
    """Return the entries of the steps, in order.

    Published numbers of stock bricks can be older than the stock: one that is scaffolding now,
    or taken by an earlier step, is not taken over.

    Args:
        path: of the task, or of the sequence that was chosen for it.
        names: of the brick types.
        stock: entries of the stock when steps prescribe it, None when they do not.
        notes: takes what is not used.
        presses_of: reads the grip of each step.
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
        brick_id = str(integer(step, "brick_id"))
        entry = {
            "brick": _name(file, key, brick_id, names),
            **cell_entry(step, ""),
            **_ways(step, presses_of.press(step, brick_id)),
        }
        if stock is not None and step.content.get("brick_seq") not in (None, "", NONE):
            source = _prescribed(step, brick_id, stock)
            if source.get("fixed") or source["name"] in used:
                why = "scaffolding" if source.get("fixed") else "taken already"
                notes.add(f"{step.where('brick_seq')}: {source['name']} is {why}")
            else:
                entry["stock"] = source["name"]
                if not source.get("station"):
                    used.add(source["name"])
        out.append(entry)
    return out


def _ways(step: Record, press: Mapping[str, Any]) -> dict[str, Any]:
    """Return how a step is done, as far as it says, with the grip that was read."""
    entry: dict[str, Any] = {}
    if choice(step, "manipulate_type", (0, 1), default=0) == 1:
        entry["place"] = "up"
    entry |= press
    if integer(step, "support_x", default=NONE) != NONE:
        entry["support"] = {
            "at": [integer(step, f"support_{k}") for k in "xyz"],
            "orientation": choice(step, "support_ori", (0, 1, 2, 3)),
        }
    if choice(step, "attack_dir", (1, -1), default=1) == -1:
        entry["attack"] = -1
    return entry


def _prescribed(
    step: Record, brick_id: str, stock: Sequence[Mapping[str, Any]]
) -> Mapping[str, Any]:
    # A station's brick is published as "station2.17": the station and the step it is for.
    sequence = str(step.content["brick_seq"]).split(".")[0]
    name = f"b{brick_id}_{sequence}"
    for item in stock:
        if item["name"] == name:
            return item
    raise ScenarioError(
        f"{step.where('brick_seq')}: there is no stock brick {name!r}",
        choices=tuple(
            str(item["name"])
            for item in stock
            if str(item["name"]).startswith(f"b{brick_id}_")
        ),
    )


def _name(file: Record, key: str, brick_id: str, names: Mapping[str, str]) -> str:
    try:
        return names[brick_id]
    except KeyError:
        raise ScenarioError(
            f"{file.path}: {key}: the library has no brick {brick_id}",
            choices=tuple(names),
        ) from None
