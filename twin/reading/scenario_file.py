"""Reading of a scenario file.

The text is parsed as YAML, converted to sections, and checked. The result is a scenario, or a list of all problems.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from planning.files import read_file
from twin.document.section import Section
from twin.document.validation import (
    FileProblem,
    InvalidScenarioError,
    parse_document,
    validate_document,
)
from twin.document.yaml_text import Mark, YamlDocument
from twin.reading.checks import find_problems
from twin.registry import KINDS
from twin.scenario.schema import scenario_schema
from twin.scenario.sections.scenario import Scenario


def load_scenario(path: Path) -> Scenario:
    """Read and check a scenario file.

    Args:
        path: the YAML file; paths inside it are relative to its folder.

    Raises:
        InvalidScenarioError: with every problem found, each at its line and column.
    """
    return read_scenario(path)[0]


def read_scenario(path: Path) -> tuple[Scenario, YamlDocument]:
    """Read and check a scenario file; return the scenario and the text with positions."""
    return parse_scenario(path, _read_text(path))


def parse_scenario(path: Path, text: str) -> tuple[Scenario, YamlDocument]:
    """Read and check the text of a scenario file that need not exist.

    Args:
        path: where it is, or will be.
        text: its content.

    Raises:
        InvalidScenarioError: see load_scenario.
    """
    document, included = _include_section(parse_document(path, text))
    scenario = validate_document(document, Scenario, scenario_schema)
    if included is not None:
        _check_included(scenario, included)
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


def _include_section(
    document: YamlDocument,
) -> tuple[YamlDocument, YamlDocument | None]:
    """Return a scenario with its included assembly section, and the included file if any.

    Such as ``assembly.structure`` may be ``{file: NAME}``, relative to the scenario.
    """
    for kind in KINDS.load_all().values():
        for key, section in kind.included.items():
            name = _file_name(document.data, key)
            if name is not None:
                return _included(document, key, name, section)
    return document, None


def _included(
    document: YamlDocument, key: str, name: str, section: type[Section]
) -> tuple[YamlDocument, YamlDocument]:
    """Return a scenario with the section of an included file, and that file.

    Raises:
        InvalidScenarioError: the file cannot be read, or does not hold such a section.
    """
    path = document.path.parent / name
    try:
        text = read_file(path).decode("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not a UTF-8 text file"
        problem = FileProblem(
            document.mark_of(("assembly", key, "file")),
            f"{path}: cannot be read: {reason}",
        )
        raise InvalidScenarioError(document.path, [problem], document.lines) from None
    included = parse_document(path, text)
    validate_document(included, section, section.model_json_schema)
    if included.problems:
        raise InvalidScenarioError(path, included.problems, included.lines)
    data = dict(document.data)
    data["assembly"] = {**data["assembly"], key: included.data}
    return replace(document, data=data), included


def _check_included(scenario: Scenario, included: YamlDocument) -> None:
    """Raise an error for problems of an included file, with positions in it."""
    found = scenario.kind.included_problems()
    problems = [included.problem(*item) for item in found]
    if problems:
        raise InvalidScenarioError(included.path, problems, included.lines)


def _file_name(data: Any, key: str) -> str | None:
    """Return the file named in the assembly; None if the section is inline or missing."""
    assembly = data.get("assembly") if isinstance(data, dict) else None
    entry = assembly.get(key) if isinstance(assembly, dict) else None
    if not isinstance(entry, dict) or set(entry) != {"file"}:
        return None
    name = entry["file"]
    return name if isinstance(name, str) else None
