"""A structure in a file of its own, beside the scenario."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from twin.scenario.document.problems import InvalidScenarioError, Problem
from twin.scenario.document.validation import parsed, validated
from twin.scenario.document.yaml_text import KeyPath, YamlDocument
from twin.scenario.sections.drawn_structure import StructureSection
from twin.scenario.sections.lego import LegoSection
from twin.scenario.sections.scenario import Scenario

_AT: KeyPath = ("assembly", "structure")


def include_structure(
    document: YamlDocument,
) -> tuple[YamlDocument, YamlDocument | None]:
    """Return a scenario with the structure of the file it names in place of the name.

    Args:
        document: a scenario; ``assembly.structure`` may be ``{file: NAME}``, relative to it.

    Returns:
        The scenario, and the file of the structure if it names one.

    Raises:
        InvalidScenarioError: the file cannot be read, or is no structure.
    """
    name = _file_name(document.data)
    if name is None:
        return document, None
    path = document.path.parent / name
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not a UTF-8 text file"
        problem = Problem(
            document.mark_of((*_AT, "file")), f"{path}: cannot be read: {reason}"
        )
        raise InvalidScenarioError(document.path, [problem], document.lines) from None
    included = parsed(path, text)
    validated(included, StructureSection, StructureSection.model_json_schema())
    if included.problems:
        raise InvalidScenarioError(path, included.problems, included.lines)
    data = dict(document.data)
    data["assembly"] = {**data["assembly"], "structure": included.data}
    return replace(document, data=data), included


def check_structure_file(scenario: Scenario, included: YamlDocument) -> None:
    """Raise an error when the bricks in the file of a structure cannot be as they are drawn.

    Args:
        scenario: a checked scenario that names the file.
        included: the file.

    Raises:
        InvalidScenarioError: with the places in that file.
    """
    from twin.assemblies.brick_types import brick_types
    from twin.assemblies.structure_checks import find_structure_problems

    lego = scenario.assembly
    assert isinstance(lego, LegoSection)
    types = brick_types(lego)
    if any(item.brick not in types for item in lego.stock):
        return
    problems = find_structure_problems(lego, types, included, ())
    if problems:
        raise InvalidScenarioError(included.path, problems, included.lines)


def _file_name(data: Any) -> str | None:
    assembly = data.get("assembly") if isinstance(data, dict) else None
    structure = assembly.get("structure") if isinstance(assembly, dict) else None
    if not isinstance(structure, dict) or set(structure) != {"file"}:
        return None
    name = structure["file"]
    return name if isinstance(name, str) else None
