"""Reading a scenario file: text -> YAML -> sections -> checked scenario, or all problems at once."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from planning.files import read_file
from twin.document.validation import (
    FileProblem,
    InvalidScenarioError,
    parsed,
    validated,
)
from twin.document.yaml_text import Mark, YamlDocument
from twin.reading.checks import find_problems
from twin.scenario.schema import scenario_schema
from twin.scenario.sections.lego import LegoSection
from twin.scenario.sections.scenario import Scenario
from twin.scenario.sections.shapes import StructureSection


def load_scenario(path: Path) -> Scenario:
    """Read and check a scenario file.

    Args:
        path: the YAML file; paths inside it are relative to its folder.

    Raises:
        InvalidScenarioError: with every problem found, each at its line and column.
    """
    return read_scenario(path)[0]


def read_scenario(path: Path) -> tuple[Scenario, YamlDocument]:
    """Read and check a scenario file as load_scenario does; return its text with places, too."""
    return scenario_of(path, _read_text(path))


def scenario_of(path: Path, text: str) -> tuple[Scenario, YamlDocument]:
    """Read and check the text of a scenario file, which need not be there yet.

    Args:
        path: where it is, or will be.
        text: its content.

    Raises:
        InvalidScenarioError: see load_scenario.
    """
    document, included = _include_structure(parsed(path, text))
    scenario = validated(document, Scenario, scenario_schema)
    if included is not None:
        _check_structure_file(scenario, included)
    found = [document.problem(*item) for item in find_problems(scenario, path.parent)]
    if found or document.problems:
        problems = [*document.problems, *found]
        raise InvalidScenarioError(path, problems, document.lines)
    return scenario, document


def _read_text(path: Path) -> str:
    try:
        if path.is_dir():
            reason = "this is a folder, a scenario file is expected"
        else:
            return read_file(path).decode("utf-8-sig")
    except FileNotFoundError:
        reason = "no such file"
    except UnicodeDecodeError as error:
        reason = f"not a UTF-8 text file (byte {error.start})"
    except OSError as error:
        reason = f"cannot be read: {error.strerror or error}"
    raise InvalidScenarioError(path, [FileProblem(Mark(1, 1), reason)])


def _include_structure(
    document: YamlDocument,
) -> tuple[YamlDocument, YamlDocument | None]:
    """Return a scenario with the structure of the file it names, and that file if any.

    ``assembly.structure`` may be ``{file: NAME}``, relative to the scenario.
    """
    name = _file_name(document.data)
    if name is None:
        return document, None
    path = document.path.parent / name
    try:
        text = read_file(path).decode("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not a UTF-8 text file"
        problem = FileProblem(
            document.mark_of(("assembly", "structure", "file")),
            f"{path}: cannot be read: {reason}",
        )
        raise InvalidScenarioError(document.path, [problem], document.lines) from None
    included = parsed(path, text)
    validated(included, StructureSection, StructureSection.model_json_schema)
    if included.problems:
        raise InvalidScenarioError(path, included.problems, included.lines)
    data = dict(document.data)
    data["assembly"] = {**data["assembly"], "structure": included.data}
    return replace(document, data=data), included


def _check_structure_file(scenario: Scenario, included: YamlDocument) -> None:
    """Raise an error, with places in that file, for bricks that cannot be as they are drawn."""
    from twin.planning.brick_checks import find_structure_problems
    from twin.scenario.sections.lego import brick_types

    lego = scenario.assembly
    assert isinstance(lego, LegoSection)
    types = brick_types(lego)
    if any(item.brick not in types for item in lego.stock):
        return
    problems = [included.problem(*item) for item in find_structure_problems(lego)]
    if problems:
        raise InvalidScenarioError(included.path, problems, included.lines)


def _file_name(data: Any) -> str | None:
    assembly = data.get("assembly") if isinstance(data, dict) else None
    structure = assembly.get("structure") if isinstance(assembly, dict) else None
    if not isinstance(structure, dict) or set(structure) != {"file"}:
        return None
    name = structure["file"]
    return name if isinstance(name, str) else None
