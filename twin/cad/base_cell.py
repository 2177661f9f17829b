"""Cell that an imported assembly is built in: that of another scenario, or two arms at a table."""

from __future__ import annotations

import os
from collections.abc import Iterator
from copy import deepcopy
from functools import reduce
from operator import getitem
from pathlib import Path
from typing import Any

from planning.errors import RequestError
from planning.files import is_file, read_file
from twin.document.section import iterate_nested
from twin.document.yaml_text import read_yaml
from twin.reading.scenario_file import load_scenario
from twin.scenario.shipped import scenario_path, shipped_scenarios

_TEMPLATE = "tray"
"""Shipped scenario whose arms and table are taken by default."""

_TABLE = "table"

_FINGERS = ("panda_finger_joint1", "panda_finger_joint2")
"""Joints of the fingers of the default arms."""

_TIP = "tip"
"""Frame of the default arms at the tips of their fingers: low parts are gripped by it."""

OPENINGS_M = (0.04, 0.06, 0.08)
"""Openings of the default arms' fingers, which are held so far apart [m]."""

SLACK_M = 0.004
"""Fingers are farther apart than what they grip by so much at least [m]."""


def default_cell() -> dict[str, Any]:
    """Return the cell of two arms at a table."""
    cell: dict[str, Any] = _data(shipped_scenarios()[_TEMPLATE])["cell"]
    cell["fixtures"] = [own for own in cell["fixtures"] if own["name"] == _TABLE]
    return cell


def open_fingers(cell: dict[str, Any], opening: float) -> dict[str, Any]:
    """Hold the fingers of the default arms of a cell apart by an opening [m], and return the rules for their grips."""
    for robot in cell["robots"]:
        robot["joints"] = dict.fromkeys(_FINGERS, round(0.5 * opening, 4))
    return {"frame": _TIP, "opening_m": round(opening - SLACK_M, 4)}


def cell_like(name: Path, output: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the cell of a scenario file or a shipped scenario, and its rules for grips if it has any.

    Paths in it become relative to the new scenario.

    Raises:
        ScenarioError: there is no such scenario, or it is not valid.
        RequestError: it has no robots.
    """
    path = scenario_path(name).resolve()
    load_scenario(path)
    data = _data(path)
    cell = data["cell"]
    if not cell.get("robots"):
        raise RequestError(f"{path}: its cell has no listed robots")
    for keys, value in list(iterate_nested(cell)):
        if isinstance(value, str) and is_file(path.parent / value):
            target = os.path.relpath(path.parent / value, output.parent.resolve())
            *above, last = keys
            reduce(getitem, above, cell)[last] = Path(target).as_posix()
    assembly = data["assembly"]
    grips = assembly.get("grips", {}) if assembly.get("kind") == "assembly" else {}
    return cell, dict(grips)


def _data(path: Path) -> Any:
    return deepcopy(read_yaml(path, read_file(path).decode("utf-8-sig")).data)


def fixture_names(cell: dict[str, Any]) -> Iterator[str]:
    """Yield the names of the fixtures and robots of a cell."""
    for own in (*cell.get("fixtures", []), *cell["robots"]):
        yield str(own["name"])
