"""Cell that an imported assembly is built in: that of another scenario, or two arms at a table."""

from __future__ import annotations

import os
from collections.abc import Iterator
from copy import deepcopy
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

_OPEN = {"panda_finger_joint1": 0.04, "panda_finger_joint2": 0.04}
"""Fingers of the default arms, as far open as they go [m]."""

_OPENING_M = 0.08


def default_cell() -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the cell of two arms at a table, and its rules for grips."""
    data = _data(shipped_scenarios()[_TEMPLATE])
    cell = deepcopy(data["cell"])
    cell["fixtures"] = [own for own in cell["fixtures"] if own["name"] == _TABLE]
    for robot in cell["robots"]:
        robot["joints"] = dict(_OPEN)
    return cell, {"opening_m": _OPENING_M}


def cell_like(name: Path, output: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the cell of another scenario, and its rules for grips if it has any.

    Args:
        name: a scenario file, or the name of a shipped scenario.
        output: file of the new scenario, beside which paths in the cell are relative.

    Raises:
        ScenarioError: there is no such scenario, or it is not valid.
        RequestError: it has no robots.
    """
    path = scenario_path(name).resolve()
    load_scenario(path)
    data = _data(path)
    cell = deepcopy(data["cell"])
    if not cell.get("robots"):
        raise RequestError(f"{path}: its cell has no listed robots")
    for keys, value in list(iterate_nested(cell)):
        if isinstance(value, str) and is_file(path.parent / value):
            target = os.path.relpath(path.parent / value, output.parent.resolve())
            _set(cell, keys, Path(target).as_posix())
    assembly = data["assembly"]
    grips = assembly.get("grips", {}) if assembly.get("kind") == "assembly" else {}
    return cell, dict(grips)


def _data(path: Path) -> Any:
    return read_yaml(path, read_file(path).decode("utf-8-sig")).data


def _set(data: Any, keys: Any, value: str) -> None:
    *above, last = keys
    for key in above:
        data = data[key]
    data[last] = value


def fixture_names(cell: dict[str, Any]) -> Iterator[str]:
    """Yield the names of the fixtures and robots of a cell."""
    for own in (*cell.get("fixtures", []), *cell["robots"]):
        yield str(own["name"])
