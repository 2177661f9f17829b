"""The grip of a published step, which is given twice: by side and offset, and as a contact cell.

The published joint solutions follow side and offset. Where the two contradict each other that is
said, and either may be taken.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
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
)
from planning.lego.bricks.assembly import BrickType, Cell, Press
from planning.lego.bricks.grips import SIDES, offsets, press_cell

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
    at = _cell(cell)
    wanted = _cell(contact)
    found = []
    for side in sorted(SIDES, key=lambda k: k != step.content.get("press_side")):
        for offset in offsets(brick, side):
            press = Press(side, offset)
            try:
                same = press_cell(at, brick, press, up=up) == wanted
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
