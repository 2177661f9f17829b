"""Scenarios shipped with the program, by name."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path

from planning.errors import ScenarioError

_SCENARIO = "scenario.yaml"
"""Name of the scenario file in a folder."""

_YAML = (".yaml", ".yml")
_HERE = Path(__file__)

_PLACES = (_HERE.parents[1] / "shipped", _HERE.parents[2] / "scenarios")
"""Folders of the scenarios, in an installed package and in a working copy."""


@cache
def shipped_scenarios() -> Mapping[str, Path]:
    """Return the files of the scenarios that come with the program, by name."""
    place = next((place for place in _PLACES if place.is_dir()), None)
    files = [] if place is None else sorted(place.glob("*/*.yaml"))
    return {path.stem: path for path in files}


def new_scenario_path(given: Path) -> Path:
    """Return the file of a new scenario: a YAML file, or a folder's."""
    return given if given.suffix in _YAML else given / _SCENARIO


def scenario_path(given: Path) -> Path:
    """Return the scenario file of a path, a folder, or the name of a shipped scenario.

    Raises:
        ScenarioError: there is no such file, and no scenario of that name.
    """
    if (given / _SCENARIO).is_file():
        return given / _SCENARIO
    if given.is_file() or given.suffix in _YAML or len(given.parts) != 1:
        return given
    found = shipped_scenarios().get(str(given))
    if found is None and given.exists():
        return given
    if found is None:
        raise ScenarioError(
            f"{given}: no such file, and no scenario of this name comes with the program",
            choices=tuple(shipped_scenarios()),
        )
    return found
