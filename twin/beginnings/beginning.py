"""Creation of new scenarios: copies of shipped scenarios and of the files that they reference."""

from __future__ import annotations

import json
import re
from pathlib import Path

from planning.errors import OutputError, ScenarioError
from planning.files import is_file
from twin.document.section import iterate_nested
from twin.document.yaml_text import read_yaml
from twin.scenario.schema import scenario_schema
from twin.scenario.shipped import new_scenario_path, shipped_scenarios

TEMPLATE = "tray"
"""Name of the shipped scenario that is copied by default."""

SCHEMA = "scenario.schema.json"
"""File in a new folder: the JSON schema with which editors check and complete scenario keys."""

_NAME = re.compile(
    r"(?!(?:true|false|null)$)[A-Za-z][A-Za-z0-9_.-]{0,63}", re.IGNORECASE
)
"""Names that scenarios allow and that YAML reads as strings."""


def create_scenario(target: Path, name: str = TEMPLATE) -> Path:
    """Copy a shipped scenario to a path, with its referenced files next to it.

    Nothing is overwritten.

    Args:
        target: a YAML file; or a folder, which gets the schema for editors, too.
        name: of the shipped scenario.

    Returns:
        The file of the scenario, which is named after the target.

    Raises:
        ScenarioError: no scenario of that name comes with the program.
        OutputError: the file exists already, or cannot be written.
    """
    if name not in shipped_scenarios():
        choices = tuple(shipped_scenarios())
        raise ScenarioError(
            f"no scenario {name!r} comes with the program", choices=choices
        )
    source = shipped_scenarios()[name]
    return write_new_scenario(target, source.read_text(encoding="utf-8"), source.parent)


def write_new_scenario(target: Path, text: str, folder: Path) -> Path:
    """Write a scenario to a path, with its referenced files next to it.

    Args:
        target: a YAML file; or a folder, which gets the schema for editors, too.
        text: of the scenario.
        folder: where relative paths in it start.

    Returns:
        The file of the scenario, which is named after the target.

    Raises:
        OutputError: the file is there already, or cannot be written.
    """
    file = new_scenario_path(target)
    single = file == target
    beside = {
        file.parent / named: (folder / named).read_bytes()
        for _, named in iterate_nested(read_yaml(file, text).data)
        if isinstance(named, str) and Path(named).suffix and is_file(folder / named)
    }
    own_folder = file.parent.resolve()
    for path, content in {file: None, **beside}.items():
        there = path.exists() and path.read_bytes() == content
        if not (there or path.resolve().is_relative_to(own_folder)):
            raise OutputError(
                f"{path}: is not written, as it lies outside of {file.parent}: put what the scenario"
                " names there first"
            )
        if path.exists() and (content is None or path.read_bytes() != content):
            raise OutputError(f"{path}: is there already, and stays as it is")
    own = target.stem if single else target.resolve().name
    if _NAME.fullmatch(own):
        text = re.sub(r"^name: .*$", f"name: {own}", text, count=1, flags=re.MULTILINE)
    if not single:
        text = f"# yaml-language-server: $schema={SCHEMA}\n{text}"
        schema = json.dumps(scenario_schema(), indent=2) + "\n"
        beside[target / SCHEMA] = schema.encode()
    for path, content in beside.items():
        if not path.exists():
            _create(path, content)
    _create(file, text.encode())
    return file


def _create(path: Path, content: bytes) -> None:
    """Write a new file; refuse to overwrite."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("xb") as file:
            file.write(content)
    except FileExistsError:
        raise OutputError(f"{path}: is there already, and stays as it is") from None
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror}") from error
