"""Scenario files of tests: written with something else in them, read, or refused."""

from pathlib import Path

import pytest

from twin.checks.check import CheckReport, check_scenario
from twin.document.validation import InvalidScenarioError
from twin.reading.scenario_file import load_scenario, read_scenario
from twin.scenario.sections.scenario import Scenario

Change = tuple[str, str]
"""What stands in a file, and what is written in its place."""


def written(folder: Path, text: str, *changes: Change, name: str = "own.yaml") -> Path:
    """Return the file of a scenario, with changes of what stands in it."""
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    file = folder / name
    file.write_text(text, encoding="utf-8")
    return file


def loaded(folder: Path, text: str, *changes: Change) -> Scenario:
    return load_scenario(written(folder, text, *changes))


def checked(file: Path) -> CheckReport:
    return check_scenario(*read_scenario(file), file.parent)


def refusal(folder: Path, text: str, *changes: Change) -> InvalidScenarioError:
    """Return what is wrong with a scenario as it is read."""
    with pytest.raises(InvalidScenarioError) as caught:
        loaded(folder, text, *changes)
    return caught.value
