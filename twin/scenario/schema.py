"""The JSON schema of scenario files."""

from __future__ import annotations

from functools import cache
from typing import Any

from twin.scenario.sections.scenario import Scenario


@cache
def scenario_schema() -> dict[str, Any]:
    """Return the JSON schema of scenario files, for editors."""
    schema = Scenario.model_json_schema(by_alias=True)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **schema,
        "title": "Scenario of assembly-twin",
    }
