"""``twin schema``: the JSON schema of scenario files."""

from __future__ import annotations

import json

import typer

from twin.host.guard import guarded


@guarded
def schema() -> None:
    """Print the JSON schema of scenario files, for editors."""
    from twin.scenario.file import scenario_schema

    typer.echo(json.dumps(scenario_schema(), indent=2))
