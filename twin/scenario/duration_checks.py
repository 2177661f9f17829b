"""Checks of the durations in a scenario: can they exist, and whom do exceptions mean?"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from pydantic import BaseModel

from planning.errors import ScenarioError
from twin.assemblies.kinds import assembly_kind
from twin.scenario.document.problems import unknown_name
from twin.scenario.document.yaml_text import KeyPath
from twin.scenario.sections.durations import AnyDuration, EmpiricalDuration
from twin.scenario.sections.scenario import Scenario

Found = Iterator[tuple[KeyPath, str]]


def check_durations(scenario: Scenario, folder: Path) -> Found:
    """Yield what is wrong with any duration of the execution section, at its key.

    Args:
        scenario: passed the checks of its single values.
        folder: where relative paths in it start.
    """
    yield from _check_within(scenario.execution, ("execution",), folder)
    yield from _check_overrides(scenario)


def _check_within(value: object, at: KeyPath, folder: Path) -> Found:
    """Look for durations in whatever may hold some, innermost first."""
    wrong = False
    for key, part in _parts(value):
        for problem in _check_within(part, (*at, key), folder):
            wrong = True
            yield problem
    if isinstance(value, AnyDuration) and not wrong:
        yield from _check_one(value, at, folder)


def _parts(value: object) -> Iterator[tuple[str | int, object]]:
    if isinstance(value, BaseModel):
        for name in type(value).model_fields:
            yield name, getattr(value, name)
    elif isinstance(value, dict):
        yield from value.items()
    elif isinstance(value, tuple):
        yield from enumerate(value)


def _check_one(section: AnyDuration, at: KeyPath, folder: Path) -> Found:
    from twin.scenario.duration_models import duration_model

    if isinstance(section, EmpiricalDuration):
        at = (*at, "csv")
        if not (folder / section.csv).is_file():
            yield at, f"no such file: {folder / section.csv}"
            return
    try:
        duration_model(section, folder)
    except ScenarioError as error:
        yield at, str(error)


def _check_overrides(scenario: Scenario) -> Found:
    robots = tuple(robot.name for robot in scenario.cell.robots)
    kinds = tuple(assembly_kind(scenario.assembly).object_kinds())
    seen: dict[tuple[str, str | None, str | None], int] = {}
    for i, item in enumerate(scenario.execution.skill_overrides):
        at: KeyPath = ("execution", "skill_overrides", i)
        if item.robot is not None and item.robot not in robots:
            yield (*at, "robot"), unknown_name("robot", item.robot, robots)
        if item.object is not None and item.object not in kinds:
            text = unknown_name("type of object", item.object, kinds)
            yield (*at, "object"), text if kinds else "there are no objects"
        key = (item.skill, item.robot, item.object)
        if key in seen:
            yield at, f"the same exception as entry {seen[key] + 1}"
        seen.setdefault(key, i)
