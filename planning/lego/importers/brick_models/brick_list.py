"""Reading of brick lists as BrickGPT writes them: one brick per line, ``hxw (x,y,z)``.

``h`` and ``w`` are the numbers of studs along x and y. ``x`` and ``y`` are the least stud coordinates of the brick,
and ``z`` is its layer, all counted from 0.
"""

from __future__ import annotations

import re
from pathlib import Path

from planning.lego.bricks.assembly import Cell
from planning.lego.bricks.brick_types import BRICKS
from planning.lego.bricks.drawing import type_of_size
from planning.lego.importers.brick_models.model import (
    BrickModel,
    ModelBrick,
    check_faults,
    finish_model,
    read_lines,
)

FORM = "a brick is a line such as '2x4 (10,8,0)': studs along x and y, then x, y and layer from 0"

_NUMBER = r"\s*([+-]?\d{1,6})\s*"
_BRICK = re.compile(
    rf"{_NUMBER}[xX×]{_NUMBER}[\s:,]*[(\[]{_NUMBER},{_NUMBER},{_NUMBER}[)\]]\s*[,;]?\s*",
    re.ASCII,
)


def read_brick_list(path: Path) -> BrickModel:
    """Read a brick list, whose lowest layer stands on the plate.

    Blank lines and what follows a ``#`` are left out.

    Raises:
        ScenarioError: lines are no bricks, or of a size that there is not, each by its number;
            or see ``finish_model``.
    """
    faults, bricks = list[tuple[int, str]](), []
    lowest: int | None = None
    for number, line in enumerate(read_lines(path), start=1):
        text = line.split("#", 1)[0].strip()
        if not text:
            continue
        match = _BRICK.fullmatch(text)
        if match is None:
            faults.append((number, f"{_shown(text)} is no brick"))
            continue
        nx, ny, x, y, z = map(int, match.groups())
        found = type_of_size((nx, ny), BRICKS)
        if isinstance(found, str):
            faults.append((number, found))
            continue
        kind, turned = found
        lowest = z if lowest is None else min(z, lowest)
        bricks.append(ModelBrick(kind, Cell(x, y, z + 1, turned), f"line {number}"))
    check_faults(path, faults, FORM)
    notes = []
    if lowest:
        notes.append(f"the lowest layer, {lowest}, stands on the plate")
    return finish_model(path, bricks, notes)


def _shown(text: str) -> str:
    return repr(text if len(text) <= 40 else f"{text[:40]}...")
