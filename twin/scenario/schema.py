"""JSON schema of scenario files."""

from __future__ import annotations

from functools import cache
from typing import Any

from twin.registry import DURATIONS, POLICIES
from twin.scenario.sections.scenario import Scenario


def scenario_schema() -> dict[str, Any]:
    """Return the JSON schema of scenario files, for editors."""
    return _schema(DURATIONS.names(), POLICIES.names())


@cache
def _schema(*_registered: tuple[str, ...]) -> dict[str, Any]:
    """Return the schema for the registered entries, which may change while the process runs."""
    schema = Scenario.model_json_schema(by_alias=True)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **schema,
        "title": "Scenario of assembly-twin",
    }
