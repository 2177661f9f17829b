"""Reading a scenario file: text -> YAML -> sections -> checked scenario, or all problems at once."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

from twin.scenario.checks import find_problems
from twin.scenario.document.problems import InvalidScenarioError, Problem
from twin.scenario.document.validation import parsed, validated
from twin.scenario.document.yaml_text import Mark
from twin.scenario.sections.scenario import Scenario
from twin.scenario.structure_file import check_structure_file, include_structure


def load_scenario(path: Path) -> Scenario:
    """Read and check a scenario file.

    Args:
        path: the YAML file; paths inside it are relative to its folder.

    Raises:
        InvalidScenarioError: with every problem found, each at its line and column.
    """
    document, included = include_structure(parsed(path, _read_text(path)))
    scenario = validated(document, Scenario, scenario_schema())
    if included is not None:
        check_structure_file(scenario, included)
    problems = [*document.problems, *find_problems(scenario, document)]
    if problems:
        raise InvalidScenarioError(path, problems, document.lines)
    return scenario


@cache
def scenario_schema() -> dict[str, Any]:
    """Return the JSON schema of scenario files, for editors."""
    schema = Scenario.model_json_schema(by_alias=True)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **schema,
        "title": "Scenario of assembly-twin",
    }


def _read_text(path: Path) -> str:
    try:
        if path.is_dir():
            reason = "this is a folder, a scenario file is expected"
        else:
            return path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        reason = "no such file"
    except UnicodeDecodeError as error:
        reason = f"not a UTF-8 text file (byte {error.start})"
    except OSError as error:
        reason = f"cannot be read: {error.strerror or error}"
    raise InvalidScenarioError(path, [Problem(Mark(1, 1), reason)])
