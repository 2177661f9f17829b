"""Files of scenarios: ``twin scenarios``, ``validate`` and ``schema``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from planning.errors import ScenarioError
from twin.commands.options import AsJson
from twin.host.guard import ExitCode, error_message, guarded, print_error, print_json


@guarded
def scenarios(as_json: AsJson = False) -> None:
    """List the scenarios that come with the program; every command accepts their names."""
    from rich.console import Console
    from rich.table import Table

    from planning.files import read_file
    from twin.document.yaml_text import read_yaml
    from twin.scenario.shipped import shipped_scenarios

    rows = []
    for name, path in shipped_scenarios().items():
        data = read_yaml(path, read_file(path).decode("utf-8")).data
        kind = data["assembly"]["kind"]
        about = data.get("description", "")
        rows.append(
            {"name": name, "kind": kind, "description": about, "file": str(path)}
        )
    if as_json:
        print_json(rows)
        return
    table = Table(box=None, padding=(0, 2, 0, 0))
    for heading in ("name", "kind", "description"):
        table.add_column(heading, no_wrap=heading != "description")
    for row in sorted(rows, key=lambda row: (row["kind"], row["name"])):
        table.add_row(row["name"], row["kind"], row["description"])
    Console(highlight=False).print(table)
    typer.echo("twin run NAME runs one, twin init PATH --from NAME copies it.")


@guarded
def validate(
    files: Annotated[
        list[Path], typer.Argument(metavar="FILE...", help="Scenario files.")
    ],
    resolved: Annotated[
        bool,
        typer.Option(
            "--resolved", help="Print each scenario with all defaults, as JSON."
        ),
    ] = False,
) -> int:
    """Check scenario files and report every problem in them."""
    from twin.scenario.sections.kind import assembly_kind
    from twin.trial.loaded_scenario import load

    code = ExitCode.COMPLETED
    for file in files:
        try:
            scenario = load(file)
        except ScenarioError as error:
            print_error(error_message(error))
            code = ExitCode.BAD_INPUT
            continue
        if resolved:
            print_json(scenario.resolved())
        else:
            supply = assembly_kind(scenario.sections.assembly).supply()
            typer.echo(
                f"{file}: ok ({len(scenario.robots)} robots, {scenario.steps} steps, {supply})"
            )
    return code


@guarded
def schema() -> None:
    """Print the JSON schema of scenario files, for editors."""
    from twin.scenario.schema import scenario_schema

    print_json(scenario_schema())
