"""``twin validate`` and ``twin schema``: check scenario files, and say what they may hold."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from planning.errors import ScenarioError
from twin.host.guard import (
    BAD_INPUT,
    COMPLETED,
    describe,
    guarded,
    print_error,
    print_json,
)

Files = Annotated[list[Path], typer.Argument(help="Scenario files.", metavar="FILE...")]
Resolved = Annotated[
    bool,
    typer.Option("--resolved", help="Print each scenario with all defaults, as JSON."),
]


@guarded
def validate(files: Files, resolved: Resolved = False) -> int:
    """Check scenario files and report every problem in them."""
    from twin.planning.kind import assembly_kind
    from twin.scenario.file import load_scenario
    from twin.scenario.sections import scenario as model

    code = COMPLETED
    for file in files:
        try:
            scenario = load_scenario(file)
        except ScenarioError as error:
            print_error(describe(error))
            code = BAD_INPUT
            continue
        if resolved:
            print_json(model.resolved(scenario))
        else:
            assembly = assembly_kind(scenario.assembly)
            typer.echo(
                f"{file}: ok ({len(scenario.cell.robots)} robots, {assembly.steps()} steps, "
                f"{assembly.supply()})"
            )
    return code


@guarded
def schema() -> None:
    """Print the JSON schema of scenario files, for editors."""
    from twin.scenario.file import scenario_schema

    print_json(scenario_schema())
